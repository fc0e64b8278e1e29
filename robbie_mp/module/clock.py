"""The run's clock, and one that tests turn by hand."""

import time
from typing import Protocol


class Clock(Protocol):
    """Tells a run's time.

    Two readings: `now_ns` is the time of day that stamps messages; `monotonic_ns` never goes back and is what
    periods and deadlines are measured with.
    """

    def now_ns(self) -> int:
        """Nanoseconds since the epoch."""

    def monotonic_ns(self) -> int:
        """Nanoseconds since some moment in the past."""


class SystemClock:
    """The machine's own time."""

    def now_ns(self) -> int:
        """Nanoseconds since the epoch; jumps when the system's clock is set."""
        return time.time_ns()

    monotonic_ns = staticmethod(time.monotonic_ns)
    """Nanoseconds of the system's monotonic clock, the same in every process of the machine."""

    jumps = 0
    """See `robbie_mp.run.run_clock`, where it can be otherwise."""

    def at(self, machine_ns: int) -> int:
        """What `monotonic_ns` was at a moment of the machine's monotonic time."""
        return machine_ns

    def machine_s_until(self, monotonic_ns: int) -> float:
        """How long until `monotonic_ns` is so late."""
        return max(0.0, (monotonic_ns - time.monotonic_ns()) / 1e9)


class ManualClock:
    """A clock that stands still until it is told to go on."""

    def __init__(self, now_ns: int = 0):
        self._now_ns = now_ns
        self._start_ns = now_ns

    def now_ns(self) -> int:
        """Nanoseconds since the epoch."""
        return self._now_ns

    def monotonic_ns(self) -> int:
        """Nanoseconds since this clock was made."""
        return self._now_ns - self._start_ns

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self._now_ns += round(seconds * 1e9)
