"""The newest map, as pictures of its parts; only the parts that have changed are drawn again."""

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
    from robbie_mp.station.context import StationContext


TILE = 128
"""Pixels along each edge of a tile."""
MAX_PIXELS = 4_000_000
"""Of larger maps every second, third … cell is shown."""
UNKNOWN, SHADES = 0, 101
"""Places in the palette: unknown, which is transparent, then 0 free … 100 occupied."""
PALETTE = [0, 0, 0, *(level for value in range(SHADES) for level in 3 * [round(255 - 2.55 * value)])]
PLACES = np.zeros(256, np.uint8)
"""In the palette, by a cell's value as an unsigned byte: 0 to 100 %; -1 and all others are unknown."""
PLACES[:SHADES] = np.arange(1, SHADES + 1)
Tile = tuple[int, int]
"""Number along x and along y; the tiles lie in the plane as if the grid went on for ever."""


@dataclass(frozen=True)
class Drawn:
    """A tile."""

    pixels: NDArray[np.uint8]
    """(TILE, TILE) places in the palette, the least y first."""
    picture: bytes
    """PNG, the greatest y at the top."""


class MapTiles:
    """Keeps the pictures of a map's tiles, and draws those that have changed.

    A tile lies at the same cells of the plane however the grid around it grows, so one that the robot has
    left behind stays as it is. A tile of which nothing is known has no picture.
    """

    def __init__(self) -> None:
        self._drawn: dict[Tile, Drawn] = {}

    def draw(self, grid: OccupancyGrid) -> dict[str, bytes]:
        """Return the place of the map (JSON), and the pictures of its tiles; {} if it makes no sense."""
        info = grid.info
        rows, columns = info.height, info.width
        if not rows or not columns or len(grid.data) != rows * columns or not info.resolution > 0:
            return {}
        every = math.ceil(math.sqrt(rows * columns / MAX_PIXELS))
        pixel_m = info.resolution * every
        # The first pixels are at these places of the endless plane.
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
        }
        return {"place": json.dumps(place).encode(), **names}


def _turned(x: float, y: float, by_rad: float) -> tuple[float, float]:
    cosine, sine = math.cos(by_rad), math.sin(by_rad)
    return cosine * x - sine * y, sine * x + cosine * y


def _cut(pixels: NDArray[np.uint8], left: int, bottom: int) -> dict[Tile, NDArray[np.uint8]]:
    """Cut a picture whose first pixel is at (left, bottom) of the plane into tiles that show anything."""
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
"""Between maps, however many come."""


class LiveMap:
    """Draws the newest map while any page shows one; lives in the station's thread.

    Args:
        station: hears of it.
    """

    def __init__(self, station: StationContext):
        self._live = station.live
        self._grid = station.newest(OccupancyGrid)
        self._tiles = MapTiles()
        self._count = 0
        self._next_s = 0.0

    def tick(self) -> None:
        """Draw it if that is due."""
        grid, count = self._grid.message, self._grid.count
        is_due = count != self._count and time.monotonic() >= self._next_s
        if grid is not None and is_due and self._live.is_wanted(GROUP):
            self._count = count
            self._live.put(GROUP, self._tiles.draw(grid))
            self._next_s = time.monotonic() + PERIOD_S
