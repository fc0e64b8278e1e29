"""Which kind of file something is, by its content, and who describes it.

A kind that others read is described by a function of theirs, which is imported only when it is needed.
"""

import re
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import yaml

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.logs.recording.errors import LogError, LogUnreadable, NotALog
from robbie_mp.logs.recording.repair import Progress, unwatched
from robbie_mp.scene.xml_elements import is_xml

LOG = "log"
CARMEN = "CARMEN log"
MAP = "map"
URDF = "URDF"
SCENE = "scene"
BAG_1 = "ROS 1 bag"
BAG_2 = "ROS 2 bag"
DESCRIBED_BY = {
    BAG_1: "robbie_mp.logs.recording.rosbag_import:describe_bag",
    BAG_2: "robbie_mp.logs.recording.rosbag_import:describe_bag",
    CARMEN: "robbie_mp.logs.recording.carmen:describe_carmen",
    MAP: "robbie_robots.workers.maps.map_file:describe_map",
    URDF: "robbie_mp.scene.urdf:describe_urdf",
    SCENE: "robbie_mp.scene.scene_summary:describe_scene",
}
"""For each kind but logs, the function that describes such a file: labels with texts."""
LARGE = (BAG_1, BAG_2, CARMEN)
"""Those whose functions show their progress."""
KNOWN = (
    "logs (MCAP: a file or a folder), bags of ROS 1 and ROS 2, CARMEN logs, maps (their YAML file or image), "
    "URDF and xacro, scene files (YAML)"
)
HEAD_BYTES = 1 << 16
MAX_YAML_BYTES = 1 << 20
MAX_MAPS = 100
"""YAML files beside an image that are looked at."""
BEGINNINGS = (
    (b"\x89MCAP", LOG),
    (b"#ROSBAG", BAG_1),
    (b"#ROSRECORD", BAG_1),
    (b"SQLite format 3\0", BAG_2),
)
IMAGE = re.compile(rb"\x89PNG|P[1-7]\s|BM|\xff\xd8\xff|GIF8|II\*\0|MM\0\*")
KEYS = (
    (BAG_2, {"rosbag2_bagfile_information"}),
    (MAP, {"image", "resolution"}),
    (MAP, {"image", "origin"}),
    (SCENE, {"nodes"}),
    (SCENE, {"include"}),
)
"""The keys by which a YAML file is known."""


class UnknownKind(LogError, ValueError):
    """A file is of no kind that can be described, or is damaged so that its reader refuses it.

    Example scenarios:
      - `robbie info` of a text file
      - `robbie info` of an image that no map names
    """


def kind_of(path: Path) -> tuple[str, Path]:
    """Return of which kind a file is, and what its reader is given: the YAML file of a map's image.

    Raises:
        UnknownKind: it is of no kind that can be described.
        LogUnreadable: it cannot be read.
    """
    if path.is_dir():
        return (BAG_2 if any(path.glob("*.db3*")) else LOG), path
    head = _head(path)
    if kind := next((kind for begin, kind in BEGINNINGS if head.startswith(begin)), ""):
        return kind, path
    if IMAGE.match(head):
        return MAP, _map_of(path)
    if is_xml(head):
        return URDF, path
    keys = _yaml(path).keys()
    if kind := next((kind for kind, wanted in KEYS if wanted <= keys), ""):
        return kind, path.parent if kind == BAG_2 else path
    # The kind whose reader says best what is wrong. An empty file is a log that was begun.
    return (LOG if not head or path.suffix == ".mcap" else CARMEN), path


def describe(kind: str, path: Path, progress: Progress = unwatched) -> dict[str, str]:
    """Return what a file holds and what its reader leaves out, as labels with texts.

    Args:
        kind: of the file.
        path: the file.
        progress: shows how much of it is read, if that may take long.

    Raises:
        RobbieError: its reader refuses it.
    """
    module, _, function = DESCRIBED_BY[kind].partition(":")
    try:
        describes = getattr(import_module(module), function)
        described: dict[str, str] = describes(path, progress) if kind in LARGE else describes(path)
    except NotALog:
        raise UnknownKind(f"{path} is none of the files that can be described: {KNOWN}") from None
    except LogError:
        raise
    except (RobbieError, ValueError, OSError) as error:  # workers know nothing of our errors
        raise UnknownKind(str(error)) from error
    return described


def _head(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return file.read(HEAD_BYTES)
    except OSError as error:
        raise LogUnreadable(f"{path} cannot be read: {error.strerror}") from error


def _yaml(path: Path) -> dict[str, str]:
    """Return the keys of the map in a YAML file, and those values that are one text; {} if it is none."""
    try:
        with open_regular(path) as file:
            content = file.read(MAX_YAML_BYTES + 1)
        found = None if len(content) > MAX_YAML_BYTES else yaml.compose(content, _Shallow)
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return {}
    pairs = found.value if isinstance(found, yaml.MappingNode) else []
    return {
        key.value: value.value if isinstance(value, yaml.ScalarNode) else ""
        for key, value in pairs
        if isinstance(key, yaml.ScalarNode)
    }


class _Shallow(yaml.SafeLoader):
    """Reads no aliases, so that a small file stays small."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node; refuse an alias."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not followed")
        return super().compose_node(parent, index)


def _map_of(image: Path) -> Path:
    """Return the YAML file of the map that an image belongs to."""
    here = sorted(image.parent.glob("*.y*ml"))[:MAX_MAPS]
    for path in chain((image.with_suffix(".yaml"), image.with_suffix(".yml")), here):
        named = _yaml(path).get("image")
        if named and (path.parent / named).resolve() == image.resolve():
            return path
    raise UnknownKind(f"{image} is an image, and no YAML file beside it names it as that of a map; {KNOWN}")
