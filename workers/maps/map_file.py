"""Maps as files: the YAML file and the image of Nav2's nav2_map_server and ROS 1's map_server.

The reader follows `loadMapYaml` and `loadMapFromFile` of Nav2's map_io.cpp, its map_mode.hpp (Jazzy to
Lyrical), and https://wiki.ros.org/map_server, sections "Map format" and "Value Interpretation". With `p` as
the darkness of a pixel from 0 to 1, or as its brightness if the map is negated, the modes are:

  - trinary, the default: occupied from `occupied_thresh` on, free up to `free_thresh`, unknown between them;
  - scale: the same, but between the thresholds the occupancy rises linearly from 0 to 100;
  - raw: the value of the pixel, of 255, is the occupancy; unknown over 100. `negate` and the thresholds do
    not count.

In trinary and scale, a pixel that is not opaque is unknown. Where the map_servers differ:

  - ROS 1, and Nav2 up to Iron, averaged alpha into the brightness of trinary maps. Unknown space of images
    that are opaque became free by that, so it is not done here.
  - They also compared with `<` and `>` instead of `<=` and `>=`.
  - A colour is as bright as the average of its channels, as in the wiki and in Nav2 up to Iron. Later ones
    weigh green more, which makes yellow free. Greys are the same in all of them.
  - Images of 16 bits keep all their bits here, as up to Iron.
  - ROS 1 negates raw maps, and its scale ends at 99.
  - All of them take thresholds that are not in 0 to 1, or not in order. They are refused here.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.maps.image_band import MAX_CELLS, Band, MapImage, MapImageError
from robbie_robots.workers.maps.map_image import map_image
from robbie_robots.workers.maps.map_yaml import MapFileError, MapYaml, read_map_yaml
from robbie_robots.workers.maps.navigation_grid import OCCUPIED_PERCENT
from robbie_robots.workers.maps.turned_grid import axis_aligned, turned_shape

__all__ = ["MapFile", "MapFileError", "describe_map", "read_map", "write_large_map", "write_map"]

OCCUPIED_SHADE, UNKNOWN_SHADE, FREE_SHADE = 0, 205, 254
OCCUPIED_FROM, FREE_TO = 0.65, 0.196
BAND_ROWS = 64


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

    Cells are free, occupied or unknown in it, which is all that localisation and navigation look at. Of the
    modes only this one, trinary, is read alike by every map_server.

    Not for the results of a run: links are followed.

    Args:
        path: Path of the YAML file.
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
    """
    tops = range(len(cells), 0, -BAND_ROWS)
    bands = (cells[max(top - BAND_ROWS, 0) : top] for top in tops)
    write_large_map(path, cells.shape, bands, resolution_m, corner_xy_m, lambda file: file.open("wb"))


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
        "mode": "trinary",
        "resolution": float(resolution_m),
        "origin": [x_m, y_m, 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_FROM,
        "free_thresh": FREE_TO,
    }
    with opened(path) as file:
        file.write(yaml.safe_dump(described, sort_keys=False).encode())


def read_map(path: Path) -> MapFile:
    """Read a map from the YAML file of a map_server.

    A map with a turned origin becomes a grid along the axes of the map frame; see `turned_grid`.

    Raises:
        MapFileError: The file or its image cannot be read, or is not a map.
    """
    described = read_map_yaml(path)
    with _opened_image(path, described) as image:
        _check_turned(path, described, image)
        cells = np.empty((image.height, image.width), dtype=np.int8)
        for band, values in _cells(described, image):
            cells[::-1][band.rows, band.columns] = values  # an image begins with its uppermost row
        x_m, y_m, yaw_rad = described.origin
        return MapFile(*axis_aligned(cells, described.resolution_m, (x_m, y_m), yaw_rad))


def describe_map(path: Path) -> dict[str, str]:
    """Return what a map file holds, as texts by their labels.

    Raises:
        MapFileError: As `read_map` raises it.
    """
    described = read_map_yaml(path)
    with _opened_image(path, described) as image:
        _check_turned(path, described, image)
        counts = Counter[str]()
        for band, values in _cells(described, image):
            counts += _counts(values)
            if band.opaque is not None:
                counts["transparent"] += int((~band.opaque).sum())
    return _description(described, image, counts)


def _counts(values: NDArray[np.int8]) -> Counter[str]:
    unknown, occupied = (int(part.sum()) for part in (values < 0, values >= OCCUPIED_PERCENT))
    return Counter(unknown=unknown, occupied=occupied, free=values.size - unknown - occupied)


def _description(described: MapYaml, image: MapImage, counts: Counter[str]) -> dict[str, str]:
    width_m, height_m = (edge * described.resolution_m for edge in (image.width, image.height))
    x_m, y_m, yaw_rad = described.origin
    cells = ", ".join(f"{counts[name]:,} {name}" for name in ("free", "occupied", "unknown"))
    return {
        "image": f"{described.image.name} ({image.kind})",
        "size": f"{image.width} x {image.height} cells, {width_m:g} m x {height_m:g} m",
        "resolution": f"{described.resolution_m:g} m",
        "origin": f"x {x_m:g} m, y {y_m:g} m, yaw {math.degrees(yaw_rad):g}°",
        "mode": described.mode + (", negated" if described.negate else ""),
        "thresholds": f"occupied from {described.occupied_from:g}, free up to {described.free_to:g}",
        "cells": cells,
        "left out": _left_out(described, counts),
    }


def _left_out(described: MapYaml, counts: Counter[str]) -> str:
    parts = []
    if counts["transparent"]:
        meant = "read as if opaque" if described.mode == "raw" else "read as unknown"
        parts.append(f"{counts['transparent']:,} transparent pixels, {meant}")
    if described.other_keys:
        parts.append(f"unknown keys: {', '.join(described.other_keys)}")
    return "; ".join(parts) or "nothing"


@contextmanager
def _opened_image(path: Path, described: MapYaml) -> Iterator[MapImage]:
    try:
        with map_image(described.image) as image:
            yield image
    except (OSError, MapImageError, MemoryError) as error:
        raise MapFileError(f"{path}: its image {described.image} cannot be read: {error}") from error


def _check_turned(path: Path, described: MapYaml, image: MapImage) -> None:
    height, width = turned_shape((image.height, image.width), described.origin[2])
    if height * width > MAX_CELLS:
        raise MapFileError(
            f"{path}: with its yaw it would have {width} x {height} cells; turn its image instead"
        )


def _cells(described: MapYaml, image: MapImage) -> Iterator[tuple[Band, NDArray[np.int8]]]:
    """Yield the occupancy in percent `(h, w)`, -1 unknown, of each band."""
    cell_of = _cell_of_level(described, image.white)
    for band in image.bands:
        values = cell_of[band.levels]
        if band.opaque is not None and described.mode != "raw":
            values[~band.opaque] = -1
        yield band, values


def _cell_of_level(described: MapYaml, white: int) -> NDArray[np.int8]:
    """Return the occupancy in percent, -1 unknown, for each level of brightness `(white + 1,)`."""
    levels = np.arange(white + 1)
    if described.mode == "raw":
        values = np.rint(levels * (255 / white))
        return np.where(values <= 100, values, -1).astype(np.int8)
    darkness = (levels if described.negate else white - levels) / white
    span = described.occupied_from - described.free_to
    between = np.rint((darkness - described.free_to) / span * 100) if described.mode == "scale" else -1.0
    is_occupied, is_free = darkness >= described.occupied_from, darkness <= described.free_to
    return np.where(is_occupied, 100, np.where(is_free, 0, between)).astype(np.int8)
