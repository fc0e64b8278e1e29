"""Maps as files: the YAML file and image of ROS's map_server (https://wiki.ros.org/map_server, trinary)."""

import math
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from PIL import Image, UnidentifiedImageError

from robbie_robots.workers.maps.navigation_grid import OCCUPIED_PERCENT

OCCUPIED_SHADE, UNKNOWN_SHADE, FREE_SHADE = 0, 205, 254
OCCUPIED_ABOVE, FREE_BELOW = 0.65, 0.196


class MapFileError(ValueError):
    """An invalid map file; the message names the file and what was expected."""


@dataclass(frozen=True)
class MapFile:
    """The contents of a map file.

    Attributes:
        cells: Occupancy `(H, W) int8`, row 0 at the smallest y: 0 free, 100 occupied, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
    """

    cells: NDArray[np.int8]
    resolution_m: float
    corner_xy_m: NDArray[np.float64]


def write_map(path: Path, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> None:
    """Write a map: the YAML file `path`, and beside it an image with the same name and the suffix `.pgm`.

    Not for the results of a run: links are followed.

    Args:
        path: Path of the YAML file.
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
    """
    write_large_map(path, cells.shape, [cells], resolution_m, corner_xy_m, lambda file: file.open("wb"))


def write_large_map(
    path: Path,
    shape: tuple[int, ...],
    bands: Iterable[NDArray[np.int8]],
    resolution_m: float,
    corner_xy_m: ArrayLike,
    opened: Callable[[Path], AbstractContextManager[BinaryIO]],
) -> None:
    """Write a map as `write_map` does, without the need to hold all of it in memory.

    Args:
        path: Path of the YAML file.
        shape: Rows and columns of the whole map.
        bands: Bands of the map from the largest y down, each `(h, W) int8` as the cells of `write_map`.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
        opened: Opens a file for writing.
    """
    height, width = shape
    if height * width == 0:  # an image needs at least one pixel
        height, width, bands = 1, 1, [np.full((1, 1), -1, dtype=np.int8)]
    image = path.with_suffix(".pgm")
    with opened(image) as file:
        file.write(f"P5\n{width} {height}\n255\n".encode())
        for cells in bands:
            shades = np.where(cells >= OCCUPIED_PERCENT, np.uint8(OCCUPIED_SHADE), np.uint8(FREE_SHADE))
            shades[cells < 0] = UNKNOWN_SHADE
            file.write(shades[::-1].tobytes())  # an image begins with its uppermost row
    x_m, y_m = np.asarray(corner_xy_m, float).tolist()
    described = {
        "image": image.name,
        "resolution": float(resolution_m),
        "origin": [x_m, y_m, 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_ABOVE,
        "free_thresh": FREE_BELOW,
    }
    with opened(path) as file:
        file.write(yaml.safe_dump(described, sort_keys=False).encode())


def read_map(path: Path) -> MapFile:
    """Read a map from the YAML file of ROS's map_server.

    Raises:
        MapFileError: The file or its image cannot be read, or is not a map.
    """
    described = _described(path)
    resolution_m = _number(path, described, "resolution")
    if resolution_m <= 0:
        raise MapFileError(f"{path}: resolution must be greater than 0, not {resolution_m:g}")
    x_m, y_m, yaw_rad = _origin(path, described)
    if yaw_rad != 0:
        raise MapFileError(f"{path}: a rotated map (yaw {yaw_rad:g}) is not supported; rotate its image")
    image = path.parent / str(described.get("image", ""))
    try:
        with Image.open(image) as opened:
            shades = np.asarray(opened.convert("L"), dtype=float)[::-1] / 255
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise MapFileError(f"{path}: its image cannot be read: {error}") from error
    occupied = shades if described.get("negate", 0) else 1 - shades
    cells = np.full(shades.shape, -1, dtype=np.int8)
    cells[occupied > _number(path, described, "occupied_thresh")] = 100
    cells[occupied < _number(path, described, "free_thresh")] = 0
    return MapFile(cells, resolution_m, np.array([x_m, y_m]))


def _described(path: Path) -> dict[str, Any]:
    try:
        described = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise MapFileError(f"{path}: cannot be read as YAML: {error}") from error
    if not isinstance(described, dict):
        raise MapFileError(f"{path}: expected the keys that map_server writes: image, resolution, origin ...")
    return described


def _origin(path: Path, described: dict[str, Any]) -> tuple[float, float, float]:
    origin = described.get("origin")
    if (
        not isinstance(origin, list)
        or len(origin) != 3
        or not all(isinstance(value, int | float) and math.isfinite(value) for value in origin)
    ):
        raise MapFileError(f"{path}: origin must be three numbers [x, y, yaw], not {origin!r}")
    return float(origin[0]), float(origin[1]), float(origin[2])


def _number(path: Path, described: dict[str, Any], key: str) -> float:
    value = described.get(key)
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise MapFileError(f"{path}: {key} must be a finite number, not {value!r}")
    return float(value)
