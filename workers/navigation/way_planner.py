"""The path to a given place, or why there is none."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from strenum import StrEnum

from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.path_planner import PathField


class Obstruction(StrEnum):
    """Why there is no path."""

    NONE = ""
    ROBOT = "the robot is not near any drivable place"
    FORBIDDEN_ROBOT = "the robot stands in a no-go area; drive it out by hand, or remove the area"
    UNKNOWN_GOAL = "the goal lies in unknown space"
    OCCUPIED_GOAL = "the goal lies in or too near to an obstacle"
    FORBIDDEN_GOAL = "the goal lies in a no-go area"
    HIDDEN_GOAL = "a wall or an obstacle stands before the goal, and nobody can see it from there"
    BLOCKED = "an obstacle that is not on the map blocks the path"
    NO_WAY = "no path leads to the goal"


@dataclass(frozen=True)
class Way:
    """The path to a place.

    Attributes:
        obstruction: Why there is no path; NONE if there is one.
        path: `(N, 2)`, m, map frame, from the robot to the goal; empty if there is none.
        cost_m: Its length, more where it passes near obstacles.
    """

    obstruction: Obstruction
    path: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    cost_m: float = np.inf


def plan_way(
    grid: NavigationGrid, pose: ArrayLike, goal_xy_m: ArrayLike, snap_m: float, tolerance_m: float
) -> Way:
    """Plan the cheapest path.

    Args:
        grid: Where the robot may be.
        pose: The robot's (x, y, heading), m and rad, map frame.
        goal_xy_m: The goal, m, map frame.
        snap_m: Maximum distance of the robot from a drivable cell, as inside the clearance or after a jump.
        tolerance_m: Maximum distance of the path's end from the goal.
    """
    if grid.forbids(pose):
        return Way(Obstruction.FORBIDDEN_ROBOT)
    if grid.forbids(goal_xy_m):
        return Way(Obstruction.FORBIDDEN_GOAL)
    if grid.nearest(grid.drivable, pose, snap_m) is None:
        return Way(Obstruction.ROBOT)
    if grid.nearest(grid.drivable, goal_xy_m, tolerance_m) is None or not grid.holds(goal_xy_m):
        unknown = not grid.holds(goal_xy_m) or grid.unknown[grid.cell(goal_xy_m)]
        return Way(Obstruction.UNKNOWN_GOAL if unknown else Obstruction.OCCUPIED_GOAL)
    untried = grid.drivable
    # If noise has cut off the nearest drivable place, start from another one within reach.
    while (start := grid.nearest(untried, pose, snap_m)) is not None:
        ways = PathField(grid, start)
        reached = np.isfinite(ways.cost_m)
        end = grid.nearest(reached, goal_xy_m, tolerance_m)
        if end is not None:
            return Way(Obstruction.NONE, grid.middles_m(ways.path(end)), float(ways.cost_m[end]))
        untried = untried & ~reached
    return Way(Obstruction.NO_WAY)
