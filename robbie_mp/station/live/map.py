"""The newest map among the live parts."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from robbie_mp.messages import OccupancyGrid
from robbie_mp.station.map_tiles import MapTiles

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

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
