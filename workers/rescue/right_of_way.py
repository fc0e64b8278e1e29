"""Who goes first where the ways of two robots meet: the other robot, if this one is to give way to it."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.exploration.drivable_ground import SNAP_M
from robbie_robots.workers.exploration.team_claims import Claim
from robbie_robots.workers.maps.navigation_grid import Cell
from robbie_robots.workers.rescue.mission_targets import MissionMap

Points = NDArray[np.float64]

NEAR_M = 1.2
"""Robots that are farther apart need no rule."""
AHEAD_M = 1.0
"""Length of the ways that are compared."""
CLEAR_M = 0.5
"""Ways that keep this distance do not meet: two bodies, and something to spare."""
ASIDE_M = 0.6
STANDS_M = 0.3
"""A robot with a shorter way stands: one drives around it, as around other obstacles."""
CHECK_S = 0.4
LONGEST_S = 15.0
"""After this time, the robot goes on: the other one is perhaps stuck itself."""
PAUSE_S = 10.0
"""How long the rule then does not count."""


class RightOfWay:
    """Tells a robot when to give way, and where to stand meanwhile.

    The robot gives way if another one is near and their ways meet. If it stands in the other one's way, it
    goes to the nearest place beside that way. It does so for a limited time, so that no deadlock lasts.

    Args:
        clock: returns the time in s.

    Attributes:
        aside: `(3,)`, where to stand meanwhile, x, y (m) and heading (rad), map frame. None: stay here.
        refused: how often the robot has gone on because it had waited too long.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._checked_s = -np.inf
        self._since_s: float | None = None
        self._not_before_s = -np.inf
        self.aside: Points | None = None
        self.refused = 0

    @property
    def is_needed(self) -> bool:
        """Return whether the robot must give way, by the last check."""
        return self._since_s is not None

    def check(self, around: MissionMap, pose: Points, goal: Points | None, claims: Iterable[Claim]) -> bool:
        """Return whether the robot must give way now.

        Args:
            around: the newest map.
            pose: where this robot is, x, y (m) and heading (rad), map frame.
            goal: where it wants to drive; None: nowhere.
            claims: what the robots do to which this one gives way.
        """
        now_s = self._clock()
        if now_s - self._checked_s < CHECK_S:
            return self.is_needed
        self._checked_s = now_s
        ways = [] if now_s < self._not_before_s else self._ways_that_meet(around, pose, goal, claims)
        if not ways:
            self._since_s = self.aside = None
            return False
        self._since_s = now_s if self._since_s is None else self._since_s
        if now_s - self._since_s > LONGEST_S:
            self.refused += 1
            self._since_s = self.aside = None
            self._not_before_s = now_s + PAUSE_S
            return False
        self._stand_aside(around, pose, np.concatenate(ways))
        return True

    def _ways_that_meet(
        self, around: MissionMap, pose: Points, goal: Points | None, claims: Iterable[Claim]
    ) -> list[Points]:
        near = [claim for claim in claims if _away_m(claim.pose[None], pose).min() < NEAR_M]
        if not near:
            return []
        own = way_ahead(around, pose, goal)
        ways = [way_ahead(around, claim.pose, claim.goal) for claim in near]
        moving = [way for way in ways if _away_m(way, way[0]).max() >= STANDS_M]
        return [way for way in moving if min(_away_m(way, place).min() for place in own) < CLEAR_M]

    def _stand_aside(self, around: MissionMap, pose: Points, way: Points) -> None:
        """Choose the nearest place beside the way, if the robot is in the way and going nowhere better."""
        if self.aside is not None and _away_m(way, self.aside).min() >= CLEAR_M:
            return
        self.aside = None
        ways = around.ways_from(pose) if _away_m(way, pose).min() < CLEAR_M else None
        if ways is None:
            return
        cells = np.argwhere(around.goals & np.isfinite(ways.cost_m))
        places = around.grid.middles_m(cells)
        free = np.hypot(*(places[:, None] - way[None, :, :2]).transpose(2, 0, 1)).min(axis=1, initial=np.inf)
        beside = free >= ASIDE_M
        if beside.any():
            costs = np.where(beside, ways.cost_m[tuple(cells.T)], np.inf)
            self.aside = np.array([*places[np.argmin(costs)], pose[2]])


def way_ahead(around: MissionMap, pose: Points, goal: Points | None) -> Points:
    """Return the beginning of a robot's way: `(N, 2)`, m, map frame; first of all, where the robot is."""
    here = pose[None, :2]
    ways = None if goal is None else around.ways_from(pose)
    if goal is None or ways is None:
        return here
    cell: Cell | None = around.grid.nearest(np.isfinite(ways.cost_m), goal, SNAP_M)
    if cell is None:
        return here
    path = around.grid.middles_m(ways.path(cell))
    lengths_m = np.cumsum(np.hypot(*np.diff(path, axis=0, prepend=path[:1]).T))
    return np.concatenate([here, path[lengths_m <= AHEAD_M]])


def _away_m(places: Points, from_pose: Points) -> Points:
    away_m: Points = np.hypot(*(places[:, :2] - from_pose[:2]).T)
    return away_m
