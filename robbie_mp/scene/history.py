"""The history of a joint position or a pose."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Generic, TypeVar

from robbie_mp.scene.errors import NeverPlaced, TooNew, TooOld

Value = TypeVar("Value")
REFUSALS_IN_A_ROW = 10
"""After this number of values that are too old, the newest value counts as the one with the wrong time."""


class History(Generic[Value]):
    """The values of the last seconds, by time; it interpolates between them.

    Its length and its number of values are limited. A single value from the future, such as from a sensor
    whose clock is not set yet, makes all others too old; after many such values in a row the history starts
    again with them.

    Args:
        owner: what the values belong to, for error texts.
        between: interpolates: returns the value at a share (0 to 1) of the way from one value to the next.
        keep_s: how much is remembered before the newest value, in s.
        limit: most values.
    """

    def __init__(
        self, owner: str, between: Callable[[Value, Value, float], Value], keep_s: float, limit: int
    ):
        self.owner = owner
        self._between = between
        self._keep_s = keep_s
        self._keep_ns = round(keep_s * 1e9)
        self._limit = limit
        self._times: list[int] = []
        self._values: list[Value] = []
        self._refused = 0

    def __len__(self) -> int:
        return len(self._times)

    @property
    def newest_ns(self) -> int | None:
        """Time of the newest value; None if there is none."""
        return self._times[-1] if self._times else None

    def require_newest_ns(self) -> int:
        """Return the time of the newest value.

        Raises:
            NeverPlaced: there is none.
        """
        if not self._times:
            raise NeverPlaced(f"{self.owner} is not known yet; it arrives with messages")
        return self._times[-1]

    def add(self, time_ns: int, value: Value) -> None:
        """Add a value. Values may arrive late; a second value of the same time replaces the first.

        Raises:
            TooOld: the time lies before the remembered history.
        """
        times, values = self._times, self._values
        if not times or time_ns > times[-1]:
            times.append(time_ns)
            values.append(value)
            self._refused = 0
            self._forget_old()
            return
        too_old_ns = times[-1] - self._keep_ns - time_ns
        if too_old_ns > 0:
            self._refused += 1
            if self._refused >= REFUSALS_IN_A_ROW:
                self.forget()
                self.add(time_ns, value)
                return
            raise TooOld(
                f"{self.owner} is given for {seconds(time_ns)}, {too_old_ns / 1e9:.3f} s more than the "
                f"{self._keep_s:g} s that are remembered before its newest, {seconds(times[-1])}",
                too_old_ns / 1e9,
            )
        self._refused = 0
        place = bisect_left(times, time_ns)
        if times[place] == time_ns:
            values[place] = value
        else:
            times.insert(place, time_ns)
            values.insert(place, value)
            self._forget_old()

    def at(self, time_ns: int) -> Value:
        """Return the value at a time.

        Raises:
            NeverPlaced, TooOld, TooNew: it is not known.
        """
        times = self._times
        if not times:
            self.require_newest_ns()
        place = bisect_left(times, time_ns)
        if place == len(times):
            by_s = (time_ns - times[-1]) / 1e9
            raise TooNew(
                f"{self.owner} is known until {seconds(times[-1])}; asked for {by_s:.6f} s after that, "
                f"{seconds(time_ns)}",
                by_s,
            )
        later = times[place]
        if later == time_ns:
            return self._values[place]
        if place == 0:
            by_s = (later - time_ns) / 1e9
            raise TooOld(
                f"{self.owner} is known from {seconds(later)} on; asked for {by_s:.6f} s before that, "
                f"{seconds(time_ns)}",
                by_s,
            )
        earlier = times[place - 1]
        share = (time_ns - earlier) / (later - earlier)
        return self._between(self._values[place - 1], self._values[place], share)

    def forget(self) -> None:
        """Delete all values, as after a jump of time."""
        self._times.clear()
        self._values.clear()

    def _forget_old(self) -> None:
        times = self._times
        old = max(bisect_right(times, times[-1] - self._keep_ns) - 1, len(times) - self._limit)
        if old > 0:  # one value before the remembered time stays, to interpolate from
            del times[:old], self._values[:old]


def linear(first: float, second: float, share: float) -> float:
    """Interpolate between two positions."""
    return first + share * (second - first)


def circular(first: float, second: float, share: float) -> float:
    """Interpolate between two angles (rad), the shorter way round."""
    return first + share * math.remainder(second - first, 2.0 * math.pi)


def seconds(time_ns: int) -> str:
    """Return a time in words."""
    return f"{time_ns / 1e9:.6f} s"
