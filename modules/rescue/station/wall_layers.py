"""The walls that the camera has searched, and those that it has not, as layers of the operator's map."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from robbie_mp.station.map.marks import CellMarks
from robbie_robots.modules.maps.planar_messages import map_cells
from robbie_robots.modules.rescue.messages import SearchedWalls

if TYPE_CHECKING:
    from robbie_mp.station.map.marks import MapMarks
    from robbie_mp.station.watch.latest import Latest, MessageSource

LAYERS = (("Searched walls", "#0091ea", 100), ("Walls to search", "#ff6d00", 0))
"""Each with its colour, and its value in `SearchedWalls`."""


def add_wall_layers(messages: MessageSource, marks: MapMarks) -> None:
    """Add the layers to the map; constructors of panels call this."""
    newest = messages.newest(SearchedWalls)
    for title, colour, value in LAYERS:
        marks.add_cells(title, colour, partial(cells_with, newest, value))


def cells_with(newest: Latest[SearchedWalls], value: int) -> CellMarks:
    """Return the middles of all cells with a value in the newest message."""
    walls = newest.message
    if walls is None:
        return CellMarks(newest.count, np.zeros((0, 2)))
    cells, resolution_m, corner_xy_m = map_cells(walls)
    columns_rows = np.argwhere(cells == value)[:, ::-1].astype(np.float64)
    middles = (columns_rows + 0.5) * resolution_m + np.array(corner_xy_m, np.float64)
    return CellMarks(newest.count, middles.astype(np.float64))
