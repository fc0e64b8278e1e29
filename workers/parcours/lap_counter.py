"""Counts laps by wheel odometry."""

import math
from typing import Any, NamedTuple

from typing_extensions import Self

from robbie_robots.hw.pose import Pose, wrapped

LEAST_TURN_RAD = 0.85 * 2 * math.pi
"""A lap of a closed course turns the robot once; odometry may have missed some of it."""
LINE_HALF_M = 4.0
"""The line reaches this far to both sides of the start: farther than the way, because odometry drifts."""


class LapState(NamedTuple):
    """The memory of a counter; a new process continues with it."""

    start: Pose | None = None
    last: Pose | None = None
    turned_rad: float = 0.0
    """Since the last lap ended."""
    ends_s: tuple[float, ...] = ()
    """When each lap ended, s."""

    def plain(self) -> dict[str, Any]:
        """Return the state as a checkpoint holds it."""
        poses = {"start": self.start, "last": self.last}
        return {
            **{name: None if pose is None else tuple(pose) for name, pose in poses.items()},
            "turned_rad": self.turned_rad,
            "ends_s": self.ends_s,
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Return the state of which `plain` is the plain form."""
        start, last = (None if plain[name] is None else Pose(*plain[name]) for name in ("start", "last"))
        return cls(start, last, plain["turned_rad"], tuple(plain["ends_s"]))


class LapCounter:
    """Counts how often the robot has come back to the line where it started.

    A lap ends when the robot crosses the line through its start in the direction in which it started, and has
    turned once since the last lap. The course may lie to the left or to the right.

    Args:
        state: what an earlier counter remembered.

    Attributes:
        state: what it remembers now.
    """

    def __init__(self, state: LapState | None = None) -> None:
        self.state = state or LapState()

    @property
    def laps(self) -> int:
        """Number of laps that have ended."""
        return len(self.state.ends_s)

    def see(self, pose: Pose, time_s: float) -> bool:
        """Take the next pose by odometry; return whether a lap has just ended."""
        start, last, turned_rad, ends_s = self.state
        if start is None or last is None:
            self.state = LapState(pose, pose, turned_rad, ends_s)
            return False
        turned_rad += wrapped(pose.heading_rad - last.heading_rad)
        before_m, _ = _from_line(start, last)
        ahead_m, aside_m = _from_line(start, pose)
        ends = before_m < 0.0 <= ahead_m and abs(aside_m) <= LINE_HALF_M and abs(turned_rad) >= LEAST_TURN_RAD
        self.state = (
            LapState(start, pose, 0.0, (*ends_s, time_s))
            if ends
            else LapState(start, pose, turned_rad, ends_s)
        )
        return ends


def _from_line(start: Pose, pose: Pose) -> tuple[float, float]:
    """Return how far a pose is beyond the line, and how far to its left, m."""
    cos, sin = math.cos(start.heading_rad), math.sin(start.heading_rad)
    dx, dy = pose.x_m - start.x_m, pose.y_m - start.y_m
    return cos * dx + sin * dy, -sin * dx + cos * dy
