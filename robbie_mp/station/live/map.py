"""Draws the newest map as tiles, and draws only changed tiles again."""

from __future__ import annotations

import io
import json
import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from robbie_mp.messages import OccupancyGrid

if TYPE_CHECKING:
    from robbie_mp.station.live.parts import LiveParts
    from robbie_mp.station.watch.latest import Latest


TILE = 128
"""Pixels along each edge of a tile."""
MAX_PIXELS = 4_000_000
"""Maximum edge of a map in cells. Of larger maps, every second, third … cell is shown."""
UNKNOWN, SHADES = 0, 101
"""Colours of the palette: unknown, which is transparent, then 0 (free) to 100 (occupied)."""
PALETTE = [0, 0, 0, *(level for value in range(SHADES) for level in 3 * [round(255 - 2.55 * value)])]
PLACES = np.zeros(256, np.uint8)
"""Index in the palette of a cell's value as an unsigned byte: 0 to 100 %; -1 and all others are unknown."""
PLACES[:SHADES] = np.arange(1, SHADES + 1)
Tile = tuple[int, int]
"""Number of a tile along x and along y. Tiles lie on an infinite grid."""


@dataclass(frozen=True)
class Drawn:
    """A tile."""

    pixels: NDArray[np.uint8]
    """(TILE, TILE) indices in the palette, row 0 at the smallest y."""
    picture: bytes
    """PNG with the largest y at the top."""


class MapTiles:
    """Keeps the pictures of a map's tiles, and draws those that have changed.

    A tile always covers the same cells of the plane, even if the grid grows, so a tile that the robot has
    left does not change. A completely unknown tile has no picture.
    """

    def __init__(self) -> None:
        self._drawn: dict[Tile, Drawn] = {}

    def draw(self, grid: OccupancyGrid) -> dict[str, bytes]:
        """Return the position of the map (JSON) and the pictures of its tiles; {} if the map is invalid."""
        info = grid.info
        rows, columns = info.height, info.width
        if not rows or not columns or len(grid.data) != rows * columns or not info.resolution > 0:
            return {}
        every = math.ceil(math.sqrt(rows * columns / MAX_PIXELS))
        pixel_m = info.resolution * every
        # Positions of the first pixels on the infinite grid.
        yaw_rad = info.origin.orientation.yaw
        x_m, y_m = _turned(info.origin.position.x, info.origin.position.y, -yaw_rad)
        left, bottom = round(x_m / pixel_m), round(y_m / pixel_m)
        pixels = PLACES[grid.data.view(np.uint8).reshape(rows, columns)[::every, ::every]]
        before, self._drawn = self._drawn, {}
        for tile, cut in _cut(pixels, left, bottom).items():
            known = before.get(tile)
            is_same = known is not None and np.array_equal(known.pixels, cut)
            self._drawn[tile] = known if known and is_same else Drawn(cut.copy(), _picture(cut))
        names = {f"tile/{across}/{up}": one.picture for (across, up), one in self._drawn.items()}
        height, width = pixels.shape
        place = {
            "x_m": info.origin.position.x,
            "y_m": info.origin.position.y,
            "yaw_rad": yaw_rad,
            "pixel_m": pixel_m,
            "columns": width,
            "rows": height,
            "left": left,
            "bottom": bottom,
            "tile": TILE,
            "tiles": [[across, up] for across, up in self._drawn],
            "known": _bounds(pixels),
        }
        return {"place": json.dumps(place).encode(), **names}


def _bounds(pixels: NDArray[np.uint8]) -> list[int] | None:
    """Return the first column and row that is known and those after the last; None if nothing is known."""
    columns, rows = np.flatnonzero(pixels.any(axis=0)), np.flatnonzero(pixels.any(axis=1))
    if not len(columns):
        return None
    return [int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1]


def _turned(x: float, y: float, by_rad: float) -> tuple[float, float]:
    cosine, sine = math.cos(by_rad), math.sin(by_rad)
    return cosine * x - sine * y, sine * x + cosine * y


def _cut(pixels: NDArray[np.uint8], left: int, bottom: int) -> dict[Tile, NDArray[np.uint8]]:
    """Cut a picture whose first pixel is at (left, bottom) of the grid into tiles, without empty ones."""
    height, width = pixels.shape
    first_across, first_up = left // TILE, bottom // TILE
    across, up = -(-(left + width) // TILE) - first_across, -(-(bottom + height) // TILE) - first_up
    plane = np.full((up * TILE, across * TILE), UNKNOWN, np.uint8)
    x, y = left - first_across * TILE, bottom - first_up * TILE
    plane[y : y + height, x : x + width] = pixels
    tiles = plane.reshape(up, TILE, across, TILE).swapaxes(1, 2)
    shown = tiles.any(axis=(2, 3))
    return {(first_across + i, first_up + j): tiles[j, i] for j, i in np.argwhere(shown).tolist()}


def _picture(pixels: NDArray[np.uint8]) -> bytes:
    picture = PillowImage.fromarray(np.ascontiguousarray(pixels[::-1]))
    picture.putpalette(PALETTE)
    file = io.BytesIO()
    picture.save(file, "PNG", compress_level=1, transparency=UNKNOWN)
    return file.getvalue()


GROUP = "map"
PERIOD_S = 0.5
"""Minimum time between two drawings of the map."""


class LiveMap:
    """Draws the newest map while a page shows it. Used in the station's thread.

    Args:
        grid: holder of the newest map.
        live: takes what is drawn.
    """

    def __init__(self, grid: Latest[OccupancyGrid], live: LiveParts):
        self._live = live
        self._grid = grid
        self._tiles = MapTiles()
        self._count = 0
        self._next_s = 0.0

    def tick(self) -> None:
        """Draw the map if that is due."""
        grid, count = self._grid.message, self._grid.count
        is_due = count != self._count and time.monotonic() >= self._next_s
        if grid is not None and is_due and self._live.is_wanted(GROUP):
            self._count = count
            self._live.put(GROUP, self._tiles.draw(grid))
            self._next_s = time.monotonic() + PERIOD_S
