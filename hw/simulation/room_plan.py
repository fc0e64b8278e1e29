"""Random floor plans: rooms along a corridor, with doors, on a grid of cells."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

# In cells of 0.25 m: the minimum edge of a room, the width of the corridor, and that of a door.
ROOM_CELLS, CORRIDOR_CELLS, DOOR_CELLS = 8, 6, 4


@dataclass(frozen=True)
class CellRegion:
    """A rectangle of cells: its first row and column, and those after its last."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return self.bottom - self.top

    @property
    def columns(self) -> int:
        """Return the number of columns."""
        return self.right - self.left


@dataclass
class RoomPlan:
    """A floor plan. Each wall between two regions gets a door, so all rooms are connected.

    Attributes:
        rows: number of rows of cells, with the outer walls.
        columns: number of columns of cells, with the outer walls.
        random: source of all random choices.
        rooms: the rectangles that are not divided further.
    """

    rows: int
    columns: int
    random: np.random.Generator
    rooms: list[CellRegion] = field(default_factory=list)

    def draw(self) -> NDArray[np.bool_]:
        """Return where walls are: (rows, columns)."""
        self._walls = np.ones((self.rows, self.columns), np.bool_)
        self._partings: list[tuple[slice, slice]] = []
        inside = CellRegion(1, 1, self.rows - 1, self.columns - 1)
        corridor = self._corridor(inside)
        for region in corridor or (inside,):
            self._part(region)
        for parting in self._partings:
            self._open_doors(parting)
        return self._walls

    def _corridor(self, region: CellRegion) -> tuple[CellRegion, ...]:
        """Lay a corridor through the middle, from left to right, if there is room on both sides."""
        least, most = ROOM_CELLS, region.rows - CORRIDOR_CELLS - ROOM_CELLS - 2
        if most < least or region.columns < 2 * ROOM_CELLS:
            return ()
        above = region.top + int(self.random.integers(least, most + 1))
        below = above + CORRIDOR_CELLS + 2
        corridor = CellRegion(above + 1, region.left, below - 1, region.right)
        self._walls[corridor.top : corridor.bottom, corridor.left : corridor.right] = False
        columns = slice(region.left, region.right)
        self._partings += [(slice(above, above + 1), columns), (slice(below - 1, below), columns)]
        return (
            CellRegion(region.top, region.left, above, region.right),
            CellRegion(below, region.left, region.bottom, region.right),
        )

    def _part(self, region: CellRegion) -> None:
        """Divide a region in two, and its parts again, until they are rooms."""
        along = region.columns >= region.rows
        length = region.columns if along else region.rows
        if length < 2 * ROOM_CELLS + 1 or (length < 3 * ROOM_CELLS and self.random.random() < 0.3):
            self.rooms.append(region)
            self._walls[region.top : region.bottom, region.left : region.right] = False
            return
        wall = int(self.random.integers(ROOM_CELLS, length - ROOM_CELLS))
        if along:
            column = region.left + wall
            pieces = (
                CellRegion(region.top, region.left, region.bottom, column),
                CellRegion(region.top, column + 1, region.bottom, region.right),
            )
            self._partings.append((slice(region.top, region.bottom), slice(column, column + 1)))
        else:
            row = region.top + wall
            pieces = (
                CellRegion(region.top, region.left, row, region.right),
                CellRegion(row + 1, region.left, region.bottom, region.right),
            )
            self._partings.append((slice(row, row + 1), slice(region.left, region.right)))
        for piece in pieces:
            self._part(piece)

    def _open_doors(self, parting: tuple[slice, slice]) -> None:
        """Open one door in a wall, or more in a long one, each where both sides are free."""
        rows, columns = parting
        upright = columns.stop - columns.start == 1
        if upright:
            beside = self._walls[rows, columns.start - 1] | self._walls[rows, columns.start + 1]
        else:
            beside = self._walls[rows.start - 1, columns] | self._walls[rows.start + 1, columns]
        # One more cell on each side, so that a door does not end at a corner.
        free = np.convolve(~beside, np.ones(DOOR_CELLS + 2), mode="valid") == DOOR_CELLS + 2
        places = np.flatnonzero(free) + 1
        count = 1 + int(len(beside) > 4 * ROOM_CELLS) + int(self.random.random() < 0.3)
        for place in self.random.permutation(places)[:count]:
            begin = int(place) + (rows.start if upright else columns.start)
            door = slice(begin, begin + DOOR_CELLS)
            self._walls[(door, columns) if upright else (rows, door)] = False
