"""Costmap: the given map plus the obstacles that the laser sees now.

Layers as in Lu, Hershberger and Smart, "Layered costmaps for context-sensitive navigation" (IROS 2014). The
inflation around obstacles is that of `NavigationGrid` (places where the robot would touch an obstacle) and
`PathField` (places that it prefers to avoid).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.maps.navigation_grid import (
    FORBIDDEN,
    OCCUPIED_PERCENT,
    NavigationGrid,
    distance_cells,
)
from robbie_robots.workers.navigation.live_obstacles import LiveObstacles

KNOWN_M = 0.2  # a return this near to an obstacle of the map belongs to that obstacle
MOST_UNSEEN_M = 50.0  # a goal that is farther beyond the map than this is not sought
AROUND_GOAL_M = 1.0


class LiveCostmap:
    """A map with live obstacles on it.

    Args:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown; FORBIDDEN where no
            robot may be.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
        clearance_m: The robot's centre keeps this far from obstacles.

    Attributes:
        static_grid: The map without live obstacles.
    """

    def __init__(
        self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike, clearance_m: float
    ) -> None:
        self._cells = np.array(cells)
        self._resolution_m = resolution_m
        self._corner = np.asarray(corner_xy_m, float)
        self._clearance_m = clearance_m
        forbidden = self._cells == FORBIDDEN
        # A no-go area is no wall: the laser's returns beside it are obstacles.
        occupied = (self._cells >= OCCUPIED_PERCENT) & ~forbidden
        # What the laser sees in these cells changes nothing.
        self._settled = (distance_cells(occupied) * resolution_m <= KNOWN_M) | forbidden
        self.static_grid = self._grid(self._cells, self._corner)

    def shows_free(self, points_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which points `(N, 2)`, m, map frame, lie on free ground, away from the map's obstacles."""
        columns, rows = np.floor((points_m - self._corner) / self._resolution_m).astype(np.int64).T
        height, width = self._cells.shape
        inside = (rows >= 0) & (columns >= 0) & (rows < height) & (columns < width)
        free: NDArray[np.bool_] = np.zeros(len(points_m), bool)
        rows, columns = rows[inside], columns[inside]
        free[inside] = (self._cells[rows, columns] >= 0) & ~self._settled[rows, columns]
        return free

    def grid(self, obstacles: LiveObstacles, now_s: float) -> NavigationGrid:
        """Return the map with the current obstacles.

        Args:
            obstacles: What the laser sees.
            now_s: The time.
        """
        cells = self._marked(self._cells, self._settled, self._corner, obstacles.points(now_s))
        return self.static_grid if cells is self._cells else self._grid(cells, self._corner)

    def opened(self, obstacles: LiveObstacles, now_s: float, goal_xy_m: ArrayLike) -> NavigationGrid | None:
        """Return the same, with what was never seen as free, and large enough for a goal.

        As `allow_unknown` of ROS's planners. Free is also what is on the map but not there any more, such as
        an opened door: the newest sweep sees through it. None if the goal is too far beyond the map.

        Args:
            obstacles: What the laser sees.
            now_s: The time.
            goal_xy_m: The goal, m, map frame.
        """
        at = (np.asarray(goal_xy_m, float)[:2] - self._corner) / self._resolution_m
        around = math.ceil(AROUND_GOAL_M / self._resolution_m)
        column, row = np.floor(at).astype(np.int64).tolist()
        height, width = self._cells.shape
        rows = max(0, around - row), max(0, row + around - height)
        columns = max(0, around - column), max(0, column + around - width)
        if max(*rows, *columns) * self._resolution_m > MOST_UNSEEN_M:
            return None
        free = np.where(self._cells < 0, 0, self._cells).astype(np.int8)
        there = np.argwhere((free >= OCCUPIED_PERCENT) & (free != FORBIDDEN))
        gone = there[obstacles.sees_through((there[:, ::-1] + 0.5) * self._resolution_m + self._corner)]
        free[gone[:, 0], gone[:, 1]] = 0
        free = np.pad(free, (rows, columns))
        settled = np.pad(self._settled, (rows, columns))
        corner = self._corner - np.array([columns[0], rows[0]]) * self._resolution_m
        return self._grid(self._marked(free, settled, corner, obstacles.points(now_s)), corner)

    def _marked(
        self,
        cells: NDArray[np.int8],
        settled: NDArray[np.bool_],
        corner_xy_m: NDArray[np.float64],
        points: NDArray[np.float64],
    ) -> NDArray[np.int8]:
        """Return cells with the current obstacles; the same array if there is nothing new."""
        columns, rows = np.floor((points - corner_xy_m) / self._resolution_m).astype(np.int64).T
        height, width = cells.shape
        inside = (rows >= 0) & (columns >= 0) & (rows < height) & (columns < width)
        rows, columns = rows[inside], columns[inside]
        new = ~settled[rows, columns]
        if not new.any():
            return cells
        marked = cells.copy()
        marked[rows[new], columns[new]] = 100
        return marked

    def _grid(self, cells: NDArray[np.int8], corner_xy_m: NDArray[np.float64]) -> NavigationGrid:
        return NavigationGrid(cells, self._resolution_m, corner_xy_m, self._clearance_m)
