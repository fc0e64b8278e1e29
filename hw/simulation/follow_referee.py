"""Judges by the true poses whether a robot follows the first person of an arena."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import Pose

NEAR_M = 3.0
BESIDE_M = 0.25
"""A person between the robot and the first person is at most this far beside the line between them."""
CROSSING_S = 1.5
"""Somebody who is on the line again within this time crosses it only once."""
CLEARLY_M = 0.3
"""The robot is after the wrong person if that one is nearer by this to where it believes its person."""


@dataclass
class FollowCounts:
    """What was counted.

    Attributes:
        began_s: time of the first judgement.
        task_s: time since the robot began to follow, until it stopped for good.
        near_s: of this, the time in which the first person was within `NEAR_M`.
        following_s: of this, the time in which the robot said that it follows.
        wrong_s: of this, the time in which it was after another person.
        wrong_times: how often that began.
        crossings: how often somebody walked between robot and first person.
        farthest_m: the largest distance from the first person.
        nearest_m: the least distance of the robot's middle from anybody's.
    """

    began_s: float | None = None
    last_s: float | None = None
    task_s: float = 0.0
    near_s: float = 0.0
    following_s: float = 0.0
    wrong_s: float = 0.0
    wrong_times: int = 0
    crossings: int = 0
    farthest_m: float = 0.0
    nearest_m: float = math.inf
    is_wrong: bool = False
    has_begun: bool = False
    crossed_s: tuple[float, ...] = ()

    @property
    def near_share(self) -> float:
        """Return the share of the time in which the person was near."""
        return self.near_s / self.task_s if self.task_s else 0.0


class FollowReferee:
    """Counts.

    Args:
        start: the robot's start, the origin of its map's frame, arena frame.
        counts: what was counted before a restart.
    """

    def __init__(self, start: Pose, counts: FollowCounts | None = None) -> None:
        self._start = start
        self.counts = counts or FollowCounts()

    def see(
        self,
        now_s: float,
        robot: Pose,
        people: NDArray[np.float64],
        followed_xy_m: tuple[float, float] | None,
        is_busy: bool,
    ) -> None:
        """Judge the present.

        Args:
            now_s: the time.
            robot: where the robot is, arena frame.
            people: (P, 5), as `PersonState.shown`; the first one is to be followed.
            followed_xy_m: where the robot believes the person that it follows, m, map frame; None: it does
                not say that it follows anybody.
            is_busy: whether it follows or searches; after the first time, all the rest counts.
        """
        counts = self.counts
        if counts.began_s is None:
            counts.began_s = now_s
        step_s = 0.0 if counts.last_s is None else max(0.0, now_s - counts.last_s)
        counts.last_s = now_s
        counts.has_begun = counts.has_begun or is_busy
        if not counts.has_begun:
            return
        away = np.hypot(*(people[:, :2] - robot[:2]).T)
        counts.task_s += step_s
        counts.near_s += step_s if away[0] <= NEAR_M else 0.0
        counts.farthest_m = max(counts.farthest_m, float(away[0]))
        counts.nearest_m = min(counts.nearest_m, float(away.min()))
        self._judge_person(people, followed_xy_m, step_s)
        self._count_crossings(now_s, robot, people)

    def _judge_person(
        self, people: NDArray[np.float64], followed_xy_m: tuple[float, float] | None, step_s: float
    ) -> None:
        counts = self.counts
        if followed_xy_m is None:
            counts.is_wrong = False
            return
        counts.following_s += step_s
        place = self._start.plus(Pose(*followed_xy_m, 0.0))
        off = np.hypot(*(people[:, :2] - place[:2]).T)
        is_wrong = bool(off.min() < off[0] - CLEARLY_M)
        counts.wrong_s += step_s if is_wrong else 0.0
        counts.wrong_times += is_wrong and not counts.is_wrong
        counts.is_wrong = is_wrong

    def _count_crossings(self, now_s: float, robot: Pose, people: NDArray[np.float64]) -> None:
        """Count people who come between robot and first person."""
        counts = self.counts
        crossed = list(counts.crossed_s) or [-math.inf] * len(people)
        eye, leader = np.array(robot[:2]), people[0, :2]
        way = leader - eye
        length = float(np.hypot(*way))
        if 0.0 < length <= NEAR_M:
            for index, (x, y) in enumerate((people[:, :2] - eye).tolist()):
                along = (x * way[0] + y * way[1]) / length
                beside = abs(x * way[1] - y * way[0]) / length
                if index > 0 and beside <= BESIDE_M and 0.0 < along < length:
                    counts.crossings += now_s - crossed[index] > CROSSING_S
                    crossed[index] = now_s
        counts.crossed_s = tuple(crossed)
