"""Reads scene graphs from YAML and URDF files; every error names the file and the line.

The format is described in docs/scene-graph.md.
"""

import math
from pathlib import Path
from typing import cast

from robbie_mp.base.problem import ProfileError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.yaml_reader import read_file
from robbie_mp.scene.described import Described, Description, SceneNotes, make_node
from robbie_mp.scene.errors import SceneFileError
from robbie_mp.scene.node import JOINT_TYPES, Joint, JointType, Mimic, Node
from robbie_mp.scene.rigid_transform import IDENTITY, RigidTransform
from robbie_mp.scene.tree_check import tree_problems
from robbie_mp.scene.urdf_tree import read_urdf
from robbie_mp.scene.xml_elements import is_xml, read_content
from robbie_mp.scene.yaml_fields import Fields

FILE_KEYS = ("nodes", "include")
PLACE_KEYS = ("parent", "translation", "quaternion", "rpy", "joint")
JOINT_KEYS = ("type", "name", "axis", "limits", "mimic")
INCLUDE_KEYS = ("file", "prefix", *PLACE_KEYS)
MIMIC_KEYS = ("joint", "multiplier", "offset")
XML_SUFFIXES = (".urdf", ".xacro", ".xml")


def read_scene(file: Path, notes: SceneNotes | None = None) -> list[Node]:
    """Read the nodes of a scene graph from a YAML file, or from a URDF: a file that begins with `<`.

    Args:
        file: the file.
        notes: learns what is left out.

    Raises:
        SceneFileError: the file cannot be read, or does not describe a tree; the text has a line for each
            problem.
    """
    description = _describe(file, ())
    check(description)
    description.note(notes or SceneNotes())
    return [node for node, _ in description.nodes]


def check(description: Description) -> None:
    """Check that nodes form a tree.

    Raises:
        SceneFileError: they do not, or the description has problems.
    """
    if not description.problems:
        places = {id(node): place for node, place in description.nodes}
        first = {node.name: place for node, place in reversed(description.nodes)}
        for node, error in tree_problems([node for node, _ in description.nodes]):
            place = places[id(node)]
            also = f", first at {first[node.name]}" if first[node.name] != place else ""
            description.wrong(str(error) + also, place)
    if description.problems:
        raise SceneFileError(description.problems)


def _describe(file: Path, including: tuple[Path, ...]) -> Description:
    description = Description(file)
    try:
        content = read_content(file)
        if is_xml(content) or file.suffix.lower() in XML_SUFFIXES:
            return read_urdf(file)
        root = read_file(file)
    except (ProfileError, SceneFileError) as error:
        description.problems.extend(error.problems)
        return description
    fields = Fields(description, "", root, FILE_KEYS)
    _describe_nodes(description, fields)
    _describe_includes(description, fields, (*including, file.resolve()))
    if not description.nodes and not description.problems:
        description.wrong("the file describes no nodes", root.place)
    return description


def _describe_nodes(description: Description, fields: Fields) -> None:
    if "nodes" not in fields:
        return
    value = fields.values["nodes"].value
    if not isinstance(value, dict):
        description.wrong("nodes: expected a map of names to nodes", fields.place_of("nodes"))
        return
    for name, node in value.items():
        entry = Fields(description, f"nodes.{name}", node, PLACE_KEYS)
        make_node(description, node.place, name, *_place(description, entry))


def _describe_includes(description: Description, fields: Fields, including: tuple[Path, ...]) -> None:
    if "include" not in fields:
        return
    value = fields.values["include"].value
    if not isinstance(value, list):
        description.wrong("include: expected a list of maps", fields.place_of("include"))
        return
    for number, item in enumerate(value):
        entry = Fields(description, f"include[{number}]", item, INCLUDE_KEYS)
        _include(description, entry, including)


def _include(description: Description, entry: Fields, including: tuple[Path, ...]) -> None:
    parent, origin, joint = _place(description, entry)
    name = entry.required_text("file")
    if not name:
        return
    file = description.file.parent / name
    place = entry.place_of("file")
    if file.resolve() in including:
        description.wrong(f"{entry.path_of('file')}: {name!r} includes itself", place)
    elif not file.is_file():
        description.wrong(f"{entry.path_of('file')}: there is no file {str(file)!r}", place)
    else:
        root = f"the root of {name}"
        hanger = description.attempt(place, lambda: Node(root, parent, origin, joint), Node(root, parent))
        other = _describe(file, including)
        description.include(other, entry.text("prefix") or "", Described(hanger, place))


def _place(description: Description, fields: Fields) -> tuple[str | None, RigidTransform, Joint | None]:
    joint = None
    if "joint" in fields:
        joint = _joint(
            description, Fields(description, fields.path_of("joint"), fields.values["joint"], JOINT_KEYS)
        )
    return fields.text("parent"), _origin(description, fields), joint


def _origin(description: Description, fields: Fields) -> RigidTransform:
    translation = fields.numbers("translation", 3) or (0.0, 0.0, 0.0)
    rpy, quaternion = fields.numbers("rpy", 3), fields.numbers("quaternion", 4)
    if "rpy" in fields and "quaternion" in fields:
        description.wrong(
            f"{fields.path_of('rpy')}: give rpy or quaternion, not both", fields.place_of("rpy")
        )
    if rpy is not None:
        if max(map(abs, rpy)) > math.tau:
            description.wrong(
                f"{fields.path_of('rpy')}: expected rad, at most one turn; got {[*rpy]}; are they degrees?",
                fields.place_of("rpy"),
            )
        return RigidTransform.from_rpy(translation, rpy)
    place = fields.place_of("quaternion")
    return description.attempt(
        place, lambda: RigidTransform.of(translation, quaternion or (0.0, 0.0, 0.0, 1.0)), IDENTITY
    )


def _joint(description: Description, fields: Fields) -> Joint | None:
    kind = fields.required_text("type")
    if kind not in JOINT_TYPES:
        if kind:
            hint = did_you_mean(kind, JOINT_TYPES) or f"; it may be {', '.join(JOINT_TYPES)}"
            path = fields.path_of("type")
            description.wrong(f"{path}: there is no joint type {kind!r}{hint}", fields.place_of("type"))
        return None
    axis = fields.numbers("axis", 3) or (0.0, 0.0, 1.0)
    limits = fields.numbers("limits", 2)
    name, mimic = fields.text("name") or "", _mimic(description, fields)

    def make() -> Joint | None:
        return Joint(
            JointType(kind),
            name,
            cast(tuple[float, float, float], axis),
            cast(tuple[float, float] | None, limits),
            mimic,
        )

    return description.attempt(fields.place, make, None)


def _mimic(description: Description, fields: Fields) -> Mimic | None:
    if "mimic" not in fields:
        return None
    entry = Fields(description, fields.path_of("mimic"), fields.values["mimic"], MIMIC_KEYS)
    return Mimic(entry.required_text("joint"), entry.number("multiplier", 1.0), entry.number("offset", 0.0))
