"""Where the robot drives to: in front of a sign, to where it can look at a post, or to the end of the map."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workers.exploration.drivable_ground import DrivableGround
from workers.exploration.frontiers import find_frontiers
from workers.numbers.mission_states import NumbersSettings, NumbersState
from workers.numbers.sign_map import SECTORS, sector_rad
from workers.planar_pose import wrap_angle

Points = NDArray[np.float64]

SAME_M = 0.4
NEAR_FRONTIER_M = 0.6
ASIDE_M_PER_RAD = 1.5
"""The robot drives this much farther to stand straight in front of a sign."""
VIEW_RAD = 0.35
EXPLORE_LATER_M = 3.0


@dataclass(frozen=True)
class SignReport:
    """What is known about a post and its sign.

    Attributes:
        xy_m: its place, map frame.
        facing_rad: the direction in which it can be read; NaN if it has not been read.
        digit: what it shows; None as long as that is not sure, or if it is something else.
        is_open: whether it may still turn out to carry a digit.
        searched: bit k is set if the camera has looked at it from its side k.
    """

    xy_m: tuple[float, float]
    facing_rad: float
    digit: int | None
    is_open: bool
    searched: int


@dataclass(frozen=True)
class Target:
    """A place to drive to.

    Attributes:
        state: what the robot does on the way.
        goal: `(3,)`, x, y (m) and heading (rad), map frame.
        about_xy_m: what to look at from there, m, map frame.
        side: from which side, for a post.
        cost_m: path cost, and more for what is worth less.
    """

    state: NumbersState
    goal: Points
    about_xy_m: tuple[float, float]
    side: int = -1
    cost_m: float = 0.0

    def is_like(self, other: "Target") -> bool:
        """Return whether two targets are the same, except for small changes of the map."""
        near = math.dist(self.about_xy_m, other.about_xy_m) <= SAME_M
        return near and self.state is other.state and self.side == other.side


class NumbersTargets:
    """Finds targets on one map.

    Args:
        ground: the map.
        pose: the robot's pose.
        settings: distances.
    """

    def __init__(self, ground: DrivableGround, pose: Points, settings: NumbersSettings) -> None:
        self._ground = ground
        self._settings = settings
        ways = ground.ways_from(pose)
        self.can_drive = ways is not None
        """Whether the robot stands on drivable ground."""
        self._ways_m = np.full(ground.goals.shape, np.inf)
        if ways is not None:
            self._ways_m = np.where(ground.goals, ways.cost_m, np.inf)
        self._cells = np.argwhere(np.isfinite(self._ways_m))
        self._places = ground.grid.middles_m(self._cells)

    def front_of(self, sign: SignReport, avoided: Sequence[Points]) -> Target | None:
        """Return where to stop in front of a sign; None if the robot cannot drive there.

        Args:
            sign: the sign.
            avoided: goals in front of it that could not be reached.
        """
        facing_rad = 0.0 if math.isnan(sign.facing_rad) else sign.facing_rad
        stop_rad = math.pi if math.isnan(sign.facing_rad) else self._settings.stop_rad
        return self._around(
            sign, NumbersState.APPROACH, self._settings.stop_m, (facing_rad, stop_rad), avoided
        )

    def views(self, signs: Iterable[SignReport], *, again: bool) -> Iterator[Target]:
        """Return from where to look at posts.

        Args:
            signs: all posts.
            again: also those that seem to be searched.
        """
        for sign in signs:
            if sign.digit is not None or not (sign.is_open or again):
                continue
            for side in range(SECTORS):
                if sign.searched >> side & 1 and not again:
                    continue
                within = (sector_rad(side), VIEW_RAD)
                target = self._around(sign, NumbersState.SEARCH, self._settings.view_m, within, (), side)
                if target is not None:
                    yield target

    def frontiers(self) -> Iterator[Target]:
        """Return where the map ends."""
        grid = self._ground.grid
        for frontier in find_frontiers(grid, self._settings.min_frontier_m):
            cell = grid.nearest(np.isfinite(self._ways_m), frontier.middle_xy_m, NEAR_FRONTIER_M)
            if cell is not None:
                x, y = frontier.middle_xy_m.tolist()
                goal = _facing(grid.middles_m(cell), (x, y))
                cost_m = float(self._ways_m[cell]) + EXPLORE_LATER_M
                yield Target(NumbersState.EXPLORE, goal, (x, y), cost_m=cost_m)

    def _around(
        self,
        sign: SignReport,
        state: NumbersState,
        between_m: tuple[float, float],
        within: tuple[float, float],
        avoided: Sequence[Points],
        side: int = -1,
    ) -> Target | None:
        """Return the best place at a distance from a sign, in a direction from it and beside that."""
        offset = self._places - sign.xy_m
        distance_m = np.hypot(offset[:, 0], offset[:, 1])
        direction_rad, beside_rad = within
        aside_rad = np.abs(wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - direction_rad))
        good = (distance_m >= between_m[0]) & (distance_m <= between_m[1]) & (aside_rad <= beside_rad)
        for place in avoided:
            good &= np.hypot(*(self._places - place[:2]).T) > SAME_M / 2
        if not good.any():
            return None
        ways_m = self._ways_m[tuple(self._cells[good].T)]
        cost_m = ways_m + ASIDE_M_PER_RAD * aside_rad[good]
        best = int(np.argmin(cost_m))
        goal = _facing(self._places[good][best], sign.xy_m)
        return Target(state, goal, sign.xy_m, side, float(cost_m[best]))


def _facing(place: Points, about: tuple[float, float]) -> Points:
    """Return the pose at a place that faces another."""
    dx, dy = (np.asarray(about) - place).tolist()
    return np.array([*place, math.atan2(dy, dx)])
