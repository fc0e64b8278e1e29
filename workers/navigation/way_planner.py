"""The way to a given place, or why there is none."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.maps.navigation_grid import NavigationGrid
from workers.navigation.path_planner import PathField


class Obstruction(StrEnum):
    """Why there is no way."""

    NONE = ""
    ROBOT = "the robot is not near any place where it can drive"
    UNKNOWN_GOAL = "nobody knows what is at the goal"
    OCCUPIED_GOAL = "the goal lies in an obstacle, or too near to one"
    NO_WAY = "no way leads to the goal"


@dataclass(frozen=True)
class Way:
    """How to drive to a place.

    Attributes:
        obstruction: Why there is no way; NONE if there is one.
        path: `(N, 2)`, m, map frame, from the robot to the goal; empty if there is none.
        cost_m: Its length, more where it passes near obstacles.
    """

    obstruction: Obstruction
    path: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    cost_m: float = np.inf


def plan_way(
    grid: NavigationGrid, pose: ArrayLike, goal_xy_m: ArrayLike, snap_m: float, tolerance_m: float
) -> Way:
    """Plan the cheapest way.

    Args:
        grid: Where the robot may be.
        pose: The robot's (x, y, heading), m and rad, map frame.
        goal_xy_m: Where it shall go, m, map frame.
        snap_m: The robot may be so far from a drivable cell (inside the clearance, or after a pose jump).
        tolerance_m: The way may end so far from the goal.
    """
    if grid.nearest(grid.drivable, pose, snap_m) is None:
        return Way(Obstruction.ROBOT)
    if grid.nearest(grid.drivable, goal_xy_m, tolerance_m) is None or not grid.holds(goal_xy_m):
        unknown = not grid.holds(goal_xy_m) or grid.unknown[grid.cell(goal_xy_m)]
        return Way(Obstruction.UNKNOWN_GOAL if unknown else Obstruction.OCCUPIED_GOAL)
    untried = grid.drivable
    # A robot in a narrow pocket, which a cell of noise has cut off, gets out by another place in its reach.
    while (start := grid.nearest(untried, pose, snap_m)) is not None:
        ways = PathField(grid, start)
        reached = np.isfinite(ways.cost_m)
        end = grid.nearest(reached, goal_xy_m, tolerance_m)
        if end is not None:
            return Way(Obstruction.NONE, grid.middles_m(ways.path(end)), float(ways.cost_m[end]))
        untried = untried & ~reached
    return Way(Obstruction.NO_WAY)
