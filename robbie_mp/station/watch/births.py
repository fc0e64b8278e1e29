"""When what a page shows was measured, on a clock that the page's browser knows, too."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from robbie_mp.messages import Time

if TYPE_CHECKING:
    from collections.abc import Callable

    from robbie_mp.module.clock import Clock
    from robbie_mp.station.watch.latest import Latest

MAX_AGE_S = 3600.0
"""A stamp that says more, or that lies in the future, is not believed: a clock is wrong."""


class Births:
    """Tells times of measurement on the clock of ages, from the stamps of messages.

    That is the robot's monotonic clock, or the time of the log that plays.

    Args:
        clock: the station's clock, which is the robot's own.
        now_s: the clock of ages.
        is_real: whether stamps are of that clock. In a simulation or playback with a time of its own, a
            message counts as measured when it arrived.
    """

    def __init__(self, clock: Clock, now_s: Callable[[], float] = time.monotonic, *, is_real: bool):
        self._clock = clock
        self.now_s = now_s
        self._is_real = is_real

    def by_arrival(self) -> Births:
        """Return those of messages with stamps of another robot's clock: they count from their arrival."""
        return Births(self._clock, self.now_s, is_real=False)

    def of(self, latest: Latest[Any]) -> float | None:
        """Return when the newest message was measured, s; None before the first one."""
        if latest.message is None:
            return None
        return self.of_message(latest.message, latest.arrived_s)

    def of_message(self, message: Any, arrived_s: float) -> float:
        """Return when a message was measured, s.

        Args:
            message: with or without a header.
            arrived_s: when it arrived, on the clock of ages.
        """
        header = getattr(message, "header", None)
        if header is None or not self._is_real:
            return arrived_s
        age_s = (self._clock.now_ns() - header.stamp.nanoseconds) / 1e9
        return self.now_s() - age_s if 0.0 <= age_s <= MAX_AGE_S else arrived_s


def time_before(stamp: Time, age_s: float) -> Time:
    """Return the time before a stamp, such as that of an operator's input; 0 if too long ago."""
    age_ns = min(max(age_s, 0.0), MAX_AGE_S) * 1e9
    return Time.from_nanoseconds(max(0, stamp.nanoseconds - round(age_ns)))
