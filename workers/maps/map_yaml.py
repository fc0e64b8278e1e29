"""The YAML file of a map, as Nav2 and ROS 1 read it with yaml-cpp.

PyYAML's own reading would differ: in YAML 1.1, `5e-2` is a text and `1:30` is 90. So only the texts of the
values are taken from it, and aliases are not expanded.
"""

import math
import re
from pathlib import Path
from typing import NamedTuple

import yaml

MAX_YAML_BYTES, MAX_YAML_DEPTH = 16_384, 10
MIN_CELL_M, MAX_CELL_M, MAX_POSITION_M = 1e-4, 1e4, 1e7
"""What a map may describe; the same holds for messages."""
MODES = ("trinary", "scale", "raw")
KEYS = ("image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
TRUE, FALSE = ("true", "yes", "on", "y"), ("false", "no", "off", "n")


class MapFileError(ValueError):
    """An invalid map file; the message names the file and what was expected."""


class MapYaml(NamedTuple):
    """What the YAML file of a map says.

    Attributes:
        image: Path of the image.
        mode: One of MODES.
        resolution_m: Edge of a cell.
        origin: Pose of the outer corner of the lowest, leftmost pixel: x and y (m), yaw (rad), map frame.
        negate: Whether bright pixels are occupied.
        occupied_from: Least darkness, from 0 to 1, of occupied cells.
        free_to: Greatest darkness of free cells.
        other_keys: Keys that no map_server knows.
    """

    image: Path
    mode: str
    resolution_m: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_from: float
    free_to: float
    other_keys: list[str]


def read_map_yaml(path: Path) -> MapYaml:
    """Read the YAML file of a map.

    Raises:
        MapFileError: It cannot be read, or does not describe a map.
    """
    values = _values(path)
    if missing := [key for key in KEYS if key not in values and key != "mode"]:
        raise MapFileError(
            f"{path}: {', '.join(missing)} missing; a map needs {', '.join(KEYS)} (mode may miss)"
        )
    mode = _text(path, values, "mode").lower() if "mode" in values else MODES[0]
    if mode not in MODES:
        raise MapFileError(f"{path}: mode must be {', '.join(MODES)}, not {mode!r:.80}")
    described = MapYaml(
        image=path.parent / _image_name(path, values),
        mode=mode,
        resolution_m=_number(path, "resolution", _text(path, values, "resolution"), MIN_CELL_M, MAX_CELL_M),
        origin=_origin(path, values["origin"]),
        negate=_negate(path, _text(path, values, "negate")),
        occupied_from=_number(path, "occupied_thresh", _text(path, values, "occupied_thresh"), 0.0, 1.0),
        free_to=_number(path, "free_thresh", _text(path, values, "free_thresh"), 0.0, 1.0),
        other_keys=[f"{key:.40}" for key in values if key not in KEYS],
    )
    if described.occupied_from <= described.free_to:
        both = f"occupied_thresh ({described.occupied_from:g}) must be greater than free_thresh"
        raise MapFileError(f"{path}: {both} ({described.free_to:g}); are they swapped?")
    return described


def _values(path: Path) -> dict[str, yaml.Node]:
    """Return the nodes of the YAML file; what they mean in YAML 1.1 does not count."""
    try:
        content = _content(path)
        _check_depth(content)
        node = next(yaml.compose_all(content, yaml.SafeLoader), None)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise MapFileError(f"{path}: cannot be read as YAML: {error}") from error
    if not isinstance(node, yaml.MappingNode):
        raise MapFileError(f"{path}: expected the keys that map_server writes: image, resolution, origin ...")
    values: dict[str, yaml.Node] = {}
    for key, value in node.value:
        name = key.value if isinstance(key, yaml.ScalarNode) else ""
        if not name or name in values:
            raise MapFileError(f"{path}: {f'{name!r:.80} is there twice' if name else 'a key is no text'}")
        values[name] = value
    return values


def _content(path: Path) -> bytes:
    if path.exists() and not path.is_file():  # a pipe would block
        raise ValueError("it is no file")
    with path.open("rb") as file:
        content = file.read(MAX_YAML_BYTES + 1)
    if len(content) > MAX_YAML_BYTES:
        raise ValueError(f"it is longer than {MAX_YAML_BYTES:,} bytes; give the YAML file, not its image")
    return content


def _check_depth(content: bytes) -> None:
    depth = 0
    for event in yaml.parse(content, yaml.SafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_YAML_DEPTH:  # PyYAML takes minutes for what is much deeper
            raise ValueError("it is too deep")


def _text(path: Path, values: dict[str, yaml.Node], key: str) -> str:
    node = values[key]
    if not isinstance(node, yaml.ScalarNode):
        raise MapFileError(f"{path}: {key} must be one value")
    return str(node.value)


def _image_name(path: Path, values: dict[str, yaml.Node]) -> Path:
    name = _text(path, values, "image")
    if not name:
        raise MapFileError(f"{path}: image must name a file")
    return Path.home() / name[2:] if name.startswith("~/") else Path(name)


def _negate(path: Path, text: str) -> bool:
    if re.fullmatch(r"[-+]?\d{1,9}", text):
        return int(text) != 0
    if text.lower() not in TRUE + FALSE:
        raise MapFileError(f"{path}: negate must be 0 or 1, not {text!r:.80}")
    return text.lower() in TRUE


def _origin(path: Path, node: yaml.Node) -> tuple[float, float, float]:
    parts = node.value if isinstance(node, yaml.SequenceNode) else []
    texts = [str(part.value) for part in parts if isinstance(part, yaml.ScalarNode)]
    if len(texts) != 3 or len(parts) != 3:
        raise MapFileError(f"{path}: origin must be three numbers [x, y, yaw]")
    x_m, y_m, yaw_rad = (_number(path, "origin", text, -MAX_POSITION_M, MAX_POSITION_M) for text in texts)
    if abs(yaw_rad) > math.tau:
        raise MapFileError(f"{path}: the yaw of origin is at most 2 pi, not {yaw_rad:g}; is it in degrees?")
    return x_m, y_m, yaw_rad


def _number(path: Path, key: str, text: str, low: float, high: float) -> float:
    value = float(text) if NUMBER.fullmatch(text) else math.nan
    if not low <= value <= high:
        hint = "; is it in percent?" if key.endswith("thresh") and 1 < value <= 100 else ""
        raise MapFileError(f"{path}: {key} must be a number from {low:g} to {high:g}, not {text!r:.80}{hint}")
    return value
