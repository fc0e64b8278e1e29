"""A map as tasks need it that choose goals: where the robot can drive, and how far it is to there."""

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.path_planner import PathField

SNAP_M = 0.6
"""The robot may be this far from a drivable cell: within the clearance, or after a pose jump."""


class Clearances(Protocol):
    """Distances from obstacles, m."""

    @property
    def clearance_m(self) -> float:
        """Paths keep this far from obstacles."""

    @property
    def tight_clearance_m(self) -> float:
        """Paths keep this far from obstacles where the robot is already too near to one."""

    @property
    def body_radius_m(self) -> float:
        """Radius of the robot's round body."""

    @property
    def goal_clearance_m(self) -> float:
        """Goals keep this far from obstacles."""


class DrivableGround:
    """Where the robot can drive, on one map.

    Args:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
        clearances: How far paths and goals keep from obstacles.

    Attributes:
        grid: where the robot can drive.
        goals: `(H, W) bool`, the cells of `grid` that are clear enough for a goal.
    """

    def __init__(
        self,
        cells: NDArray[np.int8],
        resolution_m: float,
        corner_xy_m: ArrayLike,
        clearances: Clearances,
    ) -> None:
        self.cells = cells
        self.resolution_m = resolution_m
        self.corner_xy_m = np.asarray(corner_xy_m, float)
        self._clearances = clearances
        self.grid = NavigationGrid(cells, resolution_m, corner_xy_m, clearances.clearance_m)
        self.goals = self.grid.clear(clearances.goal_clearance_m)

    def ways_from(self, pose: ArrayLike) -> PathField | None:
        """Return the paths from a pose to all cells, or None if no drivable cell is near the robot."""
        place = np.asarray(pose, float)
        start = self.grid.nearest(self.grid.drivable, place, SNAP_M)
        if start is not None:
            return PathField(self.grid, start)
        clearances = self._clearances
        tight = self.grid.around_robot(place, clearances.body_radius_m, clearances.tight_clearance_m)
        start = tight.nearest(tight.drivable, place, SNAP_M)
        return None if start is None else PathField(tight, start)

    def way_m(self, pose: ArrayLike, goal_xy_m: ArrayLike) -> float:
        """Return the path cost to a place; +inf if no path leads there."""
        ways = self.ways_from(pose)
        if ways is None:
            return math.inf
        cell = self.grid.nearest(np.isfinite(ways.cost_m), np.asarray(goal_xy_m, float), SNAP_M)
        return math.inf if cell is None else float(ways.cost_m[cell])
