"""What the robots of a team drive to, so that they share the work.

After Burgard, Moors, Stachniss and Schneider, "Coordinated multi-robot exploration" (IEEE Transactions on
Robotics, 2005): a target is worth less the nearer it lies to the target of another robot. There, one program
assigns the targets of all robots. Here, each robot decides for itself, knowing what the others have claimed
and where they are: see `team_share`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

SAME_M = 0.8
"""A target this near to another robot's target is left to that robot."""
RANGE_M = 3.0
"""The claim makes targets dearer up to this distance."""
DISCOUNT_M = 3.0
"""How much dearer a target gets at the place that another robot has claimed."""


class SeenInVain(NamedTuple):
    """A target that a robot gave up after it was there: no other robot needs to go.

    Attributes:
        kind: name of the state in which the robot drove there.
        about_xy_m: m, this robot's map frame: what it went there for.
    """

    kind: str
    about_xy_m: tuple[float, float]


@dataclass(frozen=True)
class Claim:
    """What another robot does. All places are in this robot's map frame.

    Attributes:
        pose: `(3,)`, x, y (m) and heading (rad): where the other robot is.
        goal: `(3,)`, where it drives. None: it stands.
        target_xy_m: `(2,)`, m: what it goes there for. None: no work.
        way_m: cost of the way that it still has to go to its target.
        is_working: whether it still looks for work. False: it is on its way home for good, or has ended.
        home_xy_m: `(2,)`, m: where it drives when no work is left. None: not known.
        seen_in_vain: targets that it gave up where it was there.
    """

    pose: Points
    goal: Points | None
    target_xy_m: Points | None
    way_m: float
    is_working: bool
    home_xy_m: Points | None = None
    seen_in_vain: tuple[SeenInVain, ...] = ()


class TeamClaims:
    """The newest claim of each other robot, until it expires.

    Args:
        clock: returns the time in s.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._claims: dict[str, tuple[Claim, float]] = {}

    def see(self, robot: str, claim: Claim, valid_s: float) -> None:
        """Take a robot's claim, which replaces its last one and expires unless renewed."""
        self._claims[robot] = claim, self._clock() + valid_s

    @property
    def current(self) -> dict[str, Claim]:
        """Return the claims that have not expired, by robot."""
        now_s = self._clock()
        return {robot: claim for robot, (claim, until_s) in self._claims.items() if now_s < until_s}

    @property
    def is_anyone_working(self) -> bool:
        """Return whether another robot still works."""
        return any(claim.is_working for claim in self.current.values())

    @property
    def working(self) -> list[Claim]:
        """Return the claims of the robots that still look for work."""
        return [claim for claim in self.current.values() if claim.is_working]

    @property
    def seen_in_vain(self) -> list[SeenInVain]:
        """Return the targets that other robots gave up where they were there."""
        return [target for claim in self.current.values() for target in claim.seen_in_vain]

    def extra_cost_m(self, target_xy_m: Points, way_m: float, *, is_current: bool = False) -> float:
        """Return how much dearer a target is because of the others; +inf: it is left to another robot.

        Only claims of robots that are nearer to their own target count. So of two robots, one keeps its
        target, and they do not both turn away.

        Args:
            target_xy_m: `(2,)`, m, map frame.
            way_m: cost of this robot's way to the target.
            is_current: whether this robot drives there already. Then it costs no more, but it may still be
                left to a robot that is nearer. Otherwise two robots keep changing their minds.
        """
        extra_m = 0.0
        for claim in self.current.values():
            if claim.target_xy_m is None or claim.way_m >= way_m:
                continue
            away_m = math.dist(claim.target_xy_m, target_xy_m)
            if away_m <= SAME_M:
                return math.inf
            if not is_current:
                extra_m += DISCOUNT_M * max(0.0, 1.0 - away_m / RANGE_M)
        return extra_m
