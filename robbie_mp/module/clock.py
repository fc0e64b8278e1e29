"""Clocks: the machine's, and one that a test sets by hand. The run's is in `robbie_mp.run.run_clock`."""

import time
from numbers import Real
from typing import Any, Protocol

AGES_S = 1e9
"""Upper limit of times, about 30 years: longer than any run, and accepted by all system calls."""


class Clock(Protocol):
    """Gives a module the time.

    It has two readings: `now_ns` is the time of day, for stamps in messages. `monotonic_ns` never goes back;
    use it to measure periods and deadlines.
    """

    def now_ns(self) -> int:
        """Nanoseconds since the epoch."""

    def monotonic_ns(self) -> int:
        """Nanoseconds since an unspecified moment in the past."""

    @property
    def jumps(self) -> int:
        """How often the time has been set; only then may `monotonic_ns` go back."""

    def at(self, machine_ns: int) -> int:
        """Return what `monotonic_ns` was at a moment of the machine's monotonic time, in ns."""

    def machine_s_until(self, monotonic_ns: int) -> float:
        """Return the machine's time until this clock reaches `monotonic_ns`, in s; infinite if it stands."""


def follows_machine(clock: Clock) -> bool:
    """Whether a clock is the machine's own, perhaps recorded."""
    return clock.monotonic_ns is time.monotonic_ns or getattr(clock, "follows_machine", False)


def is_span(time_s: Any) -> bool:
    """Whether something can be a period, a deadline or a timeout: a number above 0, at most `AGES_S`."""
    is_number = type(time_s) is not bool and isinstance(time_s, Real)
    return is_number and bool(0 < time_s <= AGES_S)


def is_duration(time_s: Any) -> bool:
    """Whether something is a time that may pass: a number from 0, at most `AGES_S`."""
    return is_span(time_s) or (isinstance(time_s, Real) and bool(time_s == 0))


class SystemClock:
    """The machine's own time."""

    def now_ns(self) -> int:
        """Nanoseconds since the epoch; jumps when the system's clock is set."""
        return time.time_ns()

    monotonic_ns = staticmethod(time.monotonic_ns)
    """Nanoseconds of the system's monotonic clock, the same in every process of the machine."""

    jumps = 0
    """How often the time has been set: never. See `robbie_mp.run.run_clock`, which counts them."""

    def at(self, machine_ns: int) -> int:
        """Return what `monotonic_ns` was at a moment of the machine's monotonic time, in ns."""
        return machine_ns

    def machine_s_until(self, monotonic_ns: int) -> float:
        """Return the time until `monotonic_ns` reaches this value, in s; 0 if it has passed."""
        return max(0.0, (monotonic_ns - time.monotonic_ns()) / 1e9)


class ManualClock:
    """A clock that stands still until `advance` is called; then the machine's time in a test is the same."""

    jumps = 0

    def __init__(self, now_ns: int = 0):
        self._now_ns = now_ns
        self._start_ns = now_ns

    def now_ns(self) -> int:
        """Nanoseconds since the epoch."""
        return self._now_ns

    def monotonic_ns(self) -> int:
        """Nanoseconds since this clock was created."""
        return self._now_ns - self._start_ns

    def at(self, machine_ns: int) -> int:
        """Return the same."""
        return machine_ns

    def machine_s_until(self, monotonic_ns: int) -> float:
        """Return how far to `advance` until `monotonic_ns` reaches this value, in s."""
        return max(0.0, (monotonic_ns - self.monotonic_ns()) / 1e9)

    def advance(self, seconds: float) -> None:
        """Move the time forward.

        Args:
            seconds: how far.
        """
        self._now_ns += round(seconds * 1e9)
