"""Describes a URDF, and returns its text for programs that read it themselves."""

from collections import Counter
from collections.abc import Iterable
from os.path import isfile  # Path.is_file raises an error for a name that is too long
from pathlib import Path
from urllib.parse import unquote, urlsplit

from robbie_mp.scene.described import Description
from robbie_mp.scene.node import Node
from robbie_mp.scene.scene_file import check
from robbie_mp.scene.urdf_tree import describe_robot, read_robot
from robbie_mp.scene.xacro import expand, needs_xacro
from robbie_mp.scene.xml_elements import Element, decoded, parse_xml, read_content

MOST_NAMED = 12
"""Things of one kind that a description names."""
MOST_LETTERS = 300
"""Of each."""


def describe_urdf(file: Path) -> dict[str, str]:
    """Return what a URDF, or an xacro file, holds and what a scene graph leaves out, as labels with texts.

    Raises:
        SceneFileError: it cannot be used.
    """
    robot, description = read_robot(file), Description(file)
    describe_robot(description, robot)
    check(description)
    nodes = [node for node, _ in description.nodes]
    kinds = Counter(joint.attributes.get("type", "") for joint in robot.all("joint"))
    remarks = description.remarks.items()
    lines = {
        "robot": robot.attributes.get("name", "") or "without a name",
        "URDF": f"version {robot.attributes.get('version', '1.0')}{_expanded(robot, file)}",
        "root": ", ".join(node.name for node in nodes if node.parent is None),
        "links": str(len(nodes)),
        "joints": _counted(kinds),
        "mimic": _several(_mimics(nodes)),
        "shapes": _counted(Counter(shape.tag for shape in _shapes(robot))),
        "meshes": _several(_meshes(robot, file.parent)),
        "left out": _several(f"{text} ({remark.count})" for text, remark in remarks if not remark.is_warning),
        "warnings": _several(
            f"{text} ({remark.count}, first in line {remark.place.line})"
            for text, remark in remarks
            if remark.is_warning
        ),
    }
    return {label: text for label, text in lines.items() if text}


def urdf_text(file: Path) -> str:
    """Return a URDF as text, whatever its encoding is; xacro files are expanded.

    Raises:
        SceneFileError: it cannot be read, is not XML, or xacro, which it needs, fails or is missing.
    """
    content = read_content(file)
    if needs_xacro(parse_xml(content, file)):
        content = expand(file)
    return decoded(content, file)


def _expanded(robot: Element, file: Path) -> str:
    return ", expanded by xacro" if robot.place.source != file else ""


def _mimics(nodes: list[Node]) -> Iterable[str]:
    for node in nodes:
        joint = node.joint
        if joint is not None and (mimic := joint.mimic) is not None:
            offset = f" {mimic.offset:+g}" if mimic.offset else ""
            yield f"{joint.name} = {mimic.multiplier:g} {mimic.joint}{offset}"


def _shapes(robot: Element) -> Iterable[Element]:
    for element in robot.walk():
        if element.tag == "geometry":
            yield from element.children


def _meshes(robot: Element, folder: Path) -> Iterable[str]:
    files = dict.fromkeys(
        shape.attributes.get("filename", "") for shape in _shapes(robot) if shape.tag == "mesh"
    )
    return (f"{name}{_trouble(name, folder)}" for name in files)


def _trouble(name: str, folder: Path) -> str:
    """Return why a mesh is not found, in parentheses; '' if it is there."""
    try:
        address = urlsplit(name)
    except ValueError:
        return " (no address)"
    if address.scheme not in ("", "file"):
        return "" if address.scheme == "package" else f" ({address.scheme}: is not looked up)"
    return "" if isfile(folder / unquote(address.path)) else " (missing)"


def _counted(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))


def _several(texts: Iterable[str]) -> str:
    every = list(texts)
    more = [f"and {len(every) - MOST_NAMED} more"] if len(every) > MOST_NAMED else []
    return "; ".join([*(text[:MOST_LETTERS] for text in every[:MOST_NAMED]), *more])
