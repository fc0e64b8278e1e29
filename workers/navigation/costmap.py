"""Costmap: the given map plus the obstacles that the laser sees now.

Layers as in Lu, Hershberger and Smart, "Layered costmaps for context-sensitive navigation" (IROS 2014). The
inflation around obstacles is that of `NavigationGrid` (places where the robot would touch an obstacle) and
`PathField` (places that it prefers to avoid).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.maps.navigation_grid import FORBIDDEN, OCCUPIED_PERCENT, NavigationGrid, distance_cells
from workers.navigation.live_obstacles import LiveObstacles

KNOWN_M = 0.2  # a return this near to an obstacle of the map belongs to that obstacle


class Costmap:
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
        self._forbidden = self._cells == FORBIDDEN
        # A no-go area is no wall: the laser's returns beside it are obstacles.
        occupied = (self._cells >= OCCUPIED_PERCENT) & ~self._forbidden
        self._known = distance_cells(occupied) * resolution_m <= KNOWN_M
        self.static_grid = self._grid(self._cells)

    def grid(self, obstacles: LiveObstacles, now_s: float) -> NavigationGrid:
        """Return the map with the current obstacles.

        Args:
            obstacles: What the laser sees.
            now_s: The time.
        """
        points = obstacles.points(now_s)
        columns, rows = np.floor((points - self._corner) / self._resolution_m).astype(np.int64).T
        height, width = self._cells.shape
        inside = (rows >= 0) & (columns >= 0) & (rows < height) & (columns < width)
        rows, columns = rows[inside], columns[inside]
        new = ~self._known[rows, columns] & ~self._forbidden[rows, columns]
        if not new.any():
            return self.static_grid
        cells = self._cells.copy()
        cells[rows[new], columns[new]] = 100
        return self._grid(cells)

    def _grid(self, cells: NDArray[np.int8]) -> NavigationGrid:
        return NavigationGrid(cells, self._resolution_m, self._corner, self._clearance_m)
