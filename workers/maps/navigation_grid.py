"""An occupancy grid for navigation: drivable cells and distances to obstacles."""

from copy import copy

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

OCCUPIED_PERCENT = 50
# Value of cells in no-go areas. They count as occupied, whatever is there.
FORBIDDEN = 127
# Margin around the known cells, so that each of them has all its neighbours.
MARGIN_CELLS = 2
HIDES_M = 0.1
"""An obstacle that is nearer to a point than this does not hide it: the point may be its foot."""

Cell = tuple[int, int]


class NavigationGrid:
    """Free, unknown and drivable cells for a round robot, and obstacle distances; cropped to the known cells.

    Args:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown; FORBIDDEN where no
            robot may be.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
        clearance_m: The robot's centre keeps this far from obstacles.

    Attributes:
        free: `(H, W) bool`: seen, and more likely free than not.
        unknown: `(H, W) bool`: never seen.
        forbidden: `(H, W) bool`: in a no-go area.
        obstacle_distance_m: `(H, W) float64`: from the cell's middle to that of the nearest occupied cell.
        drivable: `(H, W) bool`: free and clear enough for the robot's centre.
    """

    def __init__(
        self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike, clearance_m: float
    ) -> None:
        self.resolution_m = resolution_m
        cropped, shift = _cropped(cells)
        self._corner = np.asarray(corner_xy_m, float) + shift * resolution_m
        self.unknown = cropped < 0
        self.forbidden = cropped == FORBIDDEN
        occupied = cropped >= OCCUPIED_PERCENT
        self.free = ~self.unknown & ~occupied
        self.obstacle_distance_m = distance_cells(occupied) * resolution_m
        self.drivable = self.clear(clearance_m)

    @property
    def corner_xy_m(self) -> NDArray[np.float64]:
        """Return the outer corner of cell (0, 0), m, map frame."""
        return self._corner

    @property
    def known_m2(self) -> float:
        """Return the area seen as free."""
        return float(self.free.sum()) * self.resolution_m**2

    def around_robot(self, xy_m: ArrayLike, body_radius_m: float, clearance_m: float) -> "NavigationGrid":
        """Return the grid for a robot that must leave a narrow place.

        The cells under the robot's body count as free even if the map says otherwise, as with
        `footprint_clearing_enabled` of ROS 2's costmaps; no-go areas remain. If the robot's current clearance
        is less than the given one, paths may use the smaller clearance, so the robot can leave by the way it
        came.

        Args:
            xy_m: Position of the robot, m, map frame.
            body_radius_m: Radius of the robot's round body.
            clearance_m: The robot's centre keeps this far from obstacles where it can.
        """
        rows, columns = np.indices(self.free.shape)
        places = self.middles_m(np.stack([rows, columns], axis=-1))
        under_body = np.hypot(*np.moveaxis(places - np.asarray(xy_m, float)[:2], -1, 0)) <= body_radius_m
        around = copy(self)
        around.unknown = self.unknown & ~under_body
        around.free = (self.free | under_body) & ~self.forbidden
        around.obstacle_distance_m = distance_cells(~around.unknown & ~around.free) * self.resolution_m
        has_m = float(around.obstacle_distance_m[around.cell(xy_m)]) - self.resolution_m / 2
        around.drivable = around.clear(min(clearance_m, max(has_m, 0.0)))
        return around

    def clear(self, clearance_m: float) -> NDArray[np.bool_]:
        """Return which cells `(H, W)` are free and at least this far from obstacles."""
        # Half a cell: an obstacle reaches from the middle of its cell to the edge.
        clear: NDArray[np.bool_] = self.free & (
            self.obstacle_distance_m >= clearance_m + self.resolution_m / 2
        )
        return clear

    def cell(self, xy_m: ArrayLike) -> Cell:
        """Return (row, column) of the cell around a point, or of the nearest cell if it is outside."""
        column, row = np.floor((np.asarray(xy_m, float)[:2] - self._corner) / self.resolution_m).astype(int)
        height, width = self.free.shape
        return int(np.clip(row, 0, height - 1)), int(np.clip(column, 0, width - 1))

    def holds(self, xy_m: ArrayLike) -> bool:
        """Return whether a point, m, map frame, lies on the grid."""
        column, row = (np.asarray(xy_m, float)[:2] - self._corner) / self.resolution_m
        return bool(0 <= row < self.free.shape[0] and 0 <= column < self.free.shape[1])

    def forbids(self, xy_m: ArrayLike) -> bool:
        """Return whether a point, m, map frame, lies in a no-go area."""
        return self.holds(xy_m) and bool(self.forbidden[self.cell(xy_m)])

    def hides(self, xy_m: ArrayLike, from_xy_m: ArrayLike) -> bool:
        """Return whether an obstacle stands between a point and a place that it is seen from, m, map frame.

        What is at the point itself does not count, and neither do no-go areas, nor what is not on the grid.
        """
        if not self.holds(xy_m):
            return False
        point, eye = (np.asarray(end, float)[:2] for end in (xy_m, from_xy_m))
        height, width = self.free.shape
        way_m = float(np.hypot(*(eye - point)))
        steps_m = np.arange(
            HIDES_M, min(way_m, np.hypot(height, width) * self.resolution_m), self.resolution_m / 2
        )
        places = point + steps_m[:, None] * (eye - point) / max(way_m, HIDES_M)
        columns, rows = np.floor((places - self._corner) / self.resolution_m).astype(np.int64).T
        on_grid = (rows >= 0) & (columns >= 0) & (rows < height) & (columns < width)
        obstacles = ~self.free & ~self.unknown & ~self.forbidden
        return bool(obstacles[rows[on_grid], columns[on_grid]].any())

    def middles_m(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Return the middles `(..., 2)`, m, map frame, of cells `(..., 2)` given as (row, column)."""
        return (np.asarray(cells, float)[..., ::-1] + 0.5) * self.resolution_m + self._corner

    def nearest(self, mask: NDArray[np.bool_], xy_m: ArrayLike, within_m: float) -> Cell | None:
        """Return the cell of a mask `(H, W)` nearest to a point, or None if none is within the distance."""
        cell = self.cell(xy_m)
        if mask[cell]:
            return cell
        reach = int(within_m / self.resolution_m) + 1
        top, left = max(cell[0] - reach, 0), max(cell[1] - reach, 0)
        found = np.argwhere(mask[top : cell[0] + reach + 1, left : cell[1] + reach + 1])
        found += np.array([top, left])
        if len(found) == 0:
            return None
        distances = np.hypot(*(found - cell).T)
        best = int(np.argmin(distances))
        if distances[best] * self.resolution_m > within_m:
            return None
        return int(found[best, 0]), int(found[best, 1])


def _cropped(cells: NDArray[np.int8]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Cut the grid to the known cells and a margin; also return the (column, row) of its new first cell."""
    rows, columns = (np.flatnonzero((cells >= 0).any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return np.full((2 * MARGIN_CELLS + 1,) * 2, -1, dtype=np.int8), np.zeros(2)
    known = cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shift = np.array([columns[0], rows[0]], dtype=float) - MARGIN_CELLS
    return np.pad(known, MARGIN_CELLS, constant_values=-1), shift


def distance_cells(occupied: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distance, in cells, from each cell to the nearest occupied one; +inf if there is none."""
    if not occupied.any():
        return np.full(occupied.shape, np.inf)
    distance: NDArray[np.float64] = ndimage.distance_transform_edt(~occupied)
    return distance
