"""Shortest paths to every place on a grid, keeping away from obstacles where possible.

Dijkstra's algorithm (1959) over the drivable cells and their eight neighbours; one search gives the path to
every possible goal.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from robbie_robots.workers.maps.navigation_grid import Cell, NavigationGrid

# Cells nearer to an obstacle than this cost more, up to 1 + DETOUR times as much.
COMFORT_M = 0.55
DETOUR = 3.0
# Half of the neighbours, (rows, columns); the graph is undirected.
NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


class PathField:
    """The cheapest paths from one cell to all others.

    Args:
        grid: Where the robot may be.
        start: A drivable cell, (row, column).

    Attributes:
        cost_m: `(H, W) float64`: length of the path, more where it passes near obstacles; +inf if there is
            none.
    """

    def __init__(self, grid: NavigationGrid, start: Cell) -> None:
        self._nodes = np.flatnonzero(grid.drivable)
        self._number = np.full(grid.drivable.size, -1, dtype=np.int32)
        self._number[self._nodes] = np.arange(len(self._nodes), dtype=np.int32)
        self._shape = grid.drivable.shape
        self._start = self._node(start)
        costs, before = dijkstra(
            _graph(grid, self._number.reshape(self._shape)),
            directed=False,
            indices=[self._start],
            return_predecessors=True,
        )
        self._before = before[0]
        self.cost_m: NDArray[np.float64] = np.full(self._shape, np.inf)
        self.cost_m.ravel()[self._nodes] = costs[0]

    def path(self, goal: Cell) -> NDArray[np.int64]:
        """Return the cells of the path `(N, 2)`, (row, column), from the start to a reachable goal.

        Raises:
            ValueError: No path leads to the goal.
        """
        if not np.isfinite(self.cost_m[goal]):
            raise ValueError(f"no path leads to the cell {goal}; check cost_m before you ask for a path")
        nodes = [self._node(goal)]
        while nodes[-1] != self._start:
            nodes.append(int(self._before[nodes[-1]]))
        return np.stack(np.unravel_index(self._nodes[nodes[::-1]], self._shape), axis=1)

    def _node(self, cell: Cell) -> int:
        return int(self._number[np.ravel_multi_index(cell, self._shape)])


def cell_costs(grid: NavigationGrid) -> NDArray[np.uint8]:
    """Return what it costs to be in each cell `(H, W)`: the more, the nearer an obstacle is.

    0 to 252: drivable; 253: too near to an obstacle; 254: an obstacle; 255: never seen. These are the values
    of ROS 2's costmaps (nav2_costmap_2d).
    """
    costs = np.ceil(252 * _nearness(grid)).astype(np.uint8)
    costs[~grid.drivable] = 253
    costs[~grid.free] = 254
    costs[grid.unknown] = 255
    return costs


def _nearness(grid: NavigationGrid) -> NDArray[np.float64]:
    """Return how near obstacles are to each cell, from 0 (far) to 1."""
    nearness: NDArray[np.float64] = np.clip((COMFORT_M - grid.obstacle_distance_m) / COMFORT_M, 0.0, 1.0)
    return nearness


def costs_between(grid: NavigationGrid, cells: Sequence[Cell]) -> NDArray[np.float64]:
    """Return the costs of the cheapest paths between drivable cells: `(N, N)`, m; +inf for no path."""
    nodes = np.flatnonzero(grid.drivable)
    number = np.full(grid.drivable.size, -1, dtype=np.int32)
    number[nodes] = np.arange(len(nodes), dtype=np.int32)
    of_cell = number.reshape(grid.drivable.shape)
    places = [int(of_cell[cell]) for cell in cells]
    costs: NDArray[np.float64] = dijkstra(_graph(grid, of_cell), directed=False, indices=places)
    return costs[:, places]


def _graph(grid: NavigationGrid, number: NDArray[np.int32]) -> csr_array:
    """Connect neighbouring drivable cells; a step costs its length, more where obstacles are near."""
    price = (1.0 + DETOUR * _nearness(grid)) * grid.resolution_m / 2
    height, width = number.shape
    begins, ends, costs = [], [], []
    for down, right in NEIGHBOURS:
        here = np.s_[: height - down, max(0, -right) : width - max(0, right)]
        there = np.s_[down:, max(0, right) : width - max(0, -right)]
        both = grid.drivable[here] & grid.drivable[there]
        begins.append(number[here][both])
        ends.append(number[there][both])
        costs.append((price[here] + price[there])[both] * np.hypot(down, right))
    edges = (np.concatenate(begins), np.concatenate(ends))
    size = int(grid.drivable.sum())
    return csr_array((np.concatenate(costs), edges), shape=(size, size))
