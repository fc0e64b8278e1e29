"""Exploration: choose the frontier to drive to, until no useful one is reachable.

After Yamauchi, "A frontier-based approach for autonomous exploration" (CIRA 1997); the choice weighs the path
length against the expected information, as in Burgard et al., "Coordinated multi-robot exploration" (T-RO
2005).
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from strenum import StrEnum

from robbie_robots.workers.exploration.frontiers import Frontier, find_frontiers
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.path_planner import PathField

SAME_GOAL_M = 0.5


class PlanResult(StrEnum):
    """Result of planning."""

    GO = "a path was found"
    EXPLORED = "no useful frontier is reachable"
    NO_WAY = "the robot is not near any drivable place"


@dataclass(frozen=True)
class ExplorationPlan:
    """The result of planning, with the path.

    Attributes:
        result: Whether there is a path.
        path: `(N, 2)`, m, map frame, from the robot to the goal; empty unless there is one.
        cost_m: Length of the path, more where it passes near obstacles.
        frontiers: All frontiers of useful length, also those that cannot be reached.
    """

    result: PlanResult
    path: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    cost_m: float = math.inf
    frontiers: tuple[Frontier, ...] = ()

    @property
    def goal_xy_m(self) -> NDArray[np.float64] | None:
        """Return the last point of the path, m, map frame."""
        return self.path[-1] if len(self.path) else None


@dataclass(frozen=True)
class ExplorationSettings:
    """Settings of the exploration.

    Attributes:
        min_frontier_m: Shorter frontiers are not worth a visit.
        near_frontier_m: A frontier counts as reached from a drivable cell this near.
        snap_m: The robot may be this far from a drivable cell (inside the clearance, or after a pose jump).
        gain: Path length that a metre of frontier is worth, up to `max_gain_m` of frontier.
        max_gain_m: Longer frontiers gain no more.
        turn_m_per_rad: Cost of turning towards the frontier.
        stay_m: Cost of changing the goal; keeps the robot from dithering.
        avoid_m: Goals this near to an abandoned goal are skipped.
        max_avoided: Maximum number of abandoned goals remembered; beyond it the oldest is tried again.
    """

    min_frontier_m: float = 0.4
    near_frontier_m: float = 0.4
    snap_m: float = 0.4
    gain: float = 0.3
    max_gain_m: float = 2.0
    turn_m_per_rad: float = 0.25
    stay_m: float = 0.6
    avoid_m: float = 0.3
    max_avoided: int = 32


class FrontierExploration:
    """Plans on successive maps. It remembers its goal and the abandoned goals between them."""

    def __init__(self, settings: ExplorationSettings | None = None) -> None:
        self._settings = settings or ExplorationSettings()
        self._goal: NDArray[np.float64] | None = None
        self._avoided: deque[NDArray[np.float64]] = deque(maxlen=self._settings.max_avoided)

    @property
    def avoided_xy_m(self) -> NDArray[np.float64]:
        """Return the abandoned goals: `(N, 2)`, m, map frame."""
        return np.array(self._avoided).reshape(-1, 2)

    def give_up_goal(self) -> None:
        """Abandon the current goal and its surroundings."""
        if self._goal is not None:
            self._avoided.append(self._goal)
        self._goal = None

    def plan_exploration(self, grid: NavigationGrid, pose: ArrayLike) -> ExplorationPlan:
        """Choose a frontier and plan a path to it.

        Args:
            grid: The newest map.
            pose: The robot's (x, y, heading), m and rad, map frame.
        """
        pose = np.asarray(pose, float)
        frontiers = tuple(find_frontiers(grid, self._settings.min_frontier_m))
        start = grid.nearest(grid.drivable, pose, self._settings.snap_m)
        if start is None:
            return ExplorationPlan(PlanResult.NO_WAY, frontiers=frontiers)
        ways = PathField(grid, start)
        reached = np.isfinite(ways.cost_m)
        best, best_cost = None, math.inf
        for frontier in frontiers:
            cell = grid.nearest(reached, frontier.middle_xy_m, self._settings.near_frontier_m)
            if cell is None or self._is_avoided(grid.middles_m(cell)):
                continue
            cost = self._cost_m(frontier, float(ways.cost_m[cell]), grid.middles_m(cell), pose)
            if cost < best_cost:
                best, best_cost = cell, cost
        if best is None:
            self._goal = None
            return ExplorationPlan(PlanResult.EXPLORED, frontiers=frontiers)
        self._goal = grid.middles_m(best)
        return ExplorationPlan(
            PlanResult.GO, grid.middles_m(ways.path(best)), float(ways.cost_m[best]), frontiers
        )

    def plan_way_to(self, grid: NavigationGrid, pose: ArrayLike, goal_xy_m: ArrayLike) -> ExplorationPlan:
        """Plan a path to a given place, ending within `snap_m` of it."""
        start = grid.nearest(grid.drivable, pose, self._settings.snap_m)
        if start is None:
            return ExplorationPlan(PlanResult.NO_WAY)
        ways = PathField(grid, start)
        cell = grid.nearest(np.isfinite(ways.cost_m), goal_xy_m, self._settings.snap_m)
        if cell is None:
            return ExplorationPlan(PlanResult.NO_WAY)
        return ExplorationPlan(PlanResult.GO, grid.middles_m(ways.path(cell)), float(ways.cost_m[cell]))

    def _cost_m(
        self, frontier: Frontier, way_m: float, goal: NDArray[np.float64], pose: NDArray[np.float64]
    ) -> float:
        settings = self._settings
        dx, dy = goal - pose[:2]
        turn_rad = abs(math.remainder(math.atan2(dy, dx) - pose[2], math.tau))
        cost = way_m - settings.gain * min(frontier.length_m, settings.max_gain_m)
        cost += settings.turn_m_per_rad * turn_rad
        if self._goal is not None and np.hypot(*(goal - self._goal)) > SAME_GOAL_M:
            cost += settings.stay_m
        return cost

    def _is_avoided(self, goal: NDArray[np.float64]) -> bool:
        return any(np.hypot(*(goal - avoided)) <= self._settings.avoid_m for avoided in self._avoided)
