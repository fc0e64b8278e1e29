"""Which part of a map the robot has looked at, and where it should look next."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

OCCUPIED = 65
EIGHT = np.ones((3, 3), np.bool_)


class SeenArea:
    """Keeps what was seen on a coarse grid, which grows with the map.

    A cell is seen if it is in sight of a place where the robot was, and near enough.

    Args:
        range_m: what is farther away does not count as seen.
        cell_m: edge of a cell; walls are at least as thick.
        fewest_cells: smaller parts that were not seen do not matter.
        arrived_m: at a goal, all that is this near counts as seen: cells beside walls may never be in sight.
        turn_m: the way that the robot rather drives than looks behind itself, where a course is given.
    """

    def __init__(
        self,
        range_m: float = 3.5,
        cell_m: float = 0.2,
        fewest_cells: int = 8,
        arrived_m: float = 0.8,
        turn_m: float = 2.0,
    ) -> None:
        self._range_m, self._cell_m, self._fewest_cells = range_m, cell_m, fewest_cells
        self._arrived_m, self._turn_m = arrived_m, turn_m
        self._corner = (0, 0)  # row and column of the first cell, counted from the map frame's origin
        self._free = self._blocked = self._seen = np.zeros((0, 0), np.bool_)

    def see_map(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: Sequence[float]) -> None:
        """Take the newest map.

        Args:
            cells: (H, W), 0 free to 100 occupied, -1 unknown.
            resolution_m: edge of its cells.
            corner_xy_m: outer corner of cell (0, 0), m, map frame.
        """
        corner_column, corner_row = (round(at / resolution_m) for at in corner_xy_m)
        share = max(1, round(self._cell_m / resolution_m))
        self._cell_m = share * resolution_m
        height, width = cells.shape
        rows = (np.arange(height) + corner_row) // share
        columns = (np.arange(width) + corner_column) // share
        corner = int(rows[0]), int(columns[0])
        shape = int(rows[-1]) - corner[0] + 1, int(columns[-1]) - corner[1] + 1
        place = (rows - corner[0])[:, None] * shape[1] + (columns - corner[1])[None, :]

        def anywhere(marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
            found: NDArray[np.bool_] = np.bincount(place[marked], minlength=shape[0] * shape[1]) > 0
            return found.reshape(shape)

        self._blocked = anywhere(cells >= OCCUPIED)
        self._free = anywhere((cells >= 0) & (cells < OCCUPIED)) & ~self._blocked
        self._seen = _moved(self._seen, self._corner, corner, shape)
        self._corner = corner

    def look_from(self, xy_m: Sequence[float]) -> None:
        """Mark what is in sight of a place, m, map frame, as seen."""
        eye = self._cell(xy_m)
        height, width = self._seen.shape
        if not (0 <= eye[0] < height and 0 <= eye[1] < width):
            return
        cells = self._near(eye, self._range_m)
        # Walk along all lines of sight at once, in steps of half a cell.
        steps = max(2, math.ceil(2 * self._range_m / self._cell_m))
        shares = np.linspace(0.0, 1.0, steps)[:-1, None, None]
        on_line = np.rint(np.array(eye) + shares * (cells - np.array(eye))).astype(np.intp)
        is_target = (on_line == cells).all(axis=2)
        is_hidden = (self._blocked[on_line[..., 0], on_line[..., 1]] & ~is_target).any(axis=0)
        row, column = cells[~is_hidden].T
        self._seen[row, column] = True

    def leave_out(self, xy_m: Sequence[float]) -> None:
        """Count what is right beside a place, m, map frame, as seen: the robot was or cannot go there."""
        row, column = self._near(self._cell(xy_m), self._arrived_m).T
        self._seen[row, column] = True

    def is_seen(self, xy_m: Sequence[float]) -> bool:
        """Return whether a place, m, map frame, was seen."""
        row, column = self._cell(xy_m)
        height, width = self._seen.shape
        return 0 <= row < height and 0 <= column < width and bool(self._seen[row, column])

    def next_place(
        self, from_xy_m: Sequence[float], course_rad: float | None = None
    ) -> tuple[float, float] | None:
        """Return the nearest free place that was not seen; None if there is none that can be reached.

        Args:
            from_xy_m: where the robot is, m, map frame.
            course_rad: places in this direction, map frame, count as nearer than others.

        Returns:
            m, map frame.
        """
        unseen, count = ndimage.label(self._free & ~self._seen, EIGHT)
        if not count:
            return None
        sizes = np.bincount(unseen.ravel())
        sizes[0] = 0
        steps = self._steps_from(self._cell(from_xy_m))
        row, column = np.nonzero((sizes >= self._fewest_cells)[unseen] & (steps >= 0))
        if not len(row):
            return None
        places = (np.column_stack([column, row]) + self._corner[::-1] + 0.5) * self._cell_m
        way_m = steps[row, column] * self._cell_m
        if course_rad is not None:
            away = places - np.asarray(from_xy_m)[:2]
            turn = np.arctan2(away[:, 1], away[:, 0]) - course_rad
            way_m = way_m + self._turn_m * (1.0 - np.cos(turn)) / 2
        x, y = places[int(np.argmin(way_m))].tolist()
        return x, y

    def _steps_from(self, start: tuple[int, int]) -> NDArray[np.intp]:
        """Return the number of steps to each free cell; -1 for those that cannot be reached."""
        steps = np.full(self._free.shape, -1, np.intp)
        front = np.zeros(self._free.shape, np.bool_)
        near = self._near(start, 2 * self._cell_m)  # the robot's own cell may be beside a wall
        front[near[:, 0], near[:, 1]] = True
        step = 0
        while front.any():
            steps[front] = step
            step += 1
            front = ndimage.binary_dilation(front, EIGHT) & self._free & (steps < 0)
        return steps

    def _near(self, cell: tuple[int, int], radius_m: float) -> NDArray[np.intp]:
        """Return the cells (N, 2) within a radius of a cell."""
        height, width = self._free.shape
        reach = math.ceil(radius_m / self._cell_m)
        rows = np.arange(max(0, cell[0] - reach), min(height, cell[0] + reach + 1))
        columns = np.arange(max(0, cell[1] - reach), min(width, cell[1] + reach + 1))
        cells = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        near: NDArray[np.intp] = cells[np.hypot(*(cells - cell).T) * self._cell_m <= radius_m]
        return near

    def _cell(self, xy_m: ArrayLike) -> tuple[int, int]:
        x, y = np.asarray(xy_m, float)[:2]
        row, column = math.floor(y / self._cell_m), math.floor(x / self._cell_m)
        return row - self._corner[0], column - self._corner[1]


def _moved(
    old: NDArray[np.bool_], old_corner: tuple[int, int], corner: tuple[int, int], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return a grid with another corner and shape; what it had outside of them is forgotten."""
    new = np.zeros(shape, np.bool_)
    row, column = np.nonzero(old)
    row, column = row + old_corner[0] - corner[0], column + old_corner[1] - corner[1]
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    new[row[inside], column[inside]] = True
    return new
