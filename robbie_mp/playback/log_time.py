"""The time of a log that plays, and with it that of the run."""

from collections.abc import Callable
from typing import Protocol

LEASE_NS = 250_000_000
"""Time stops so long after this was last heard of: it does not go on without who plays the log."""


class ClockDriver(Protocol):
    """What sets the run's clock; see `robbie_mp.run.run_clock.ClockWriter`."""

    def play(self, at_ns: int, rate: float, limit_ns: int) -> None:
        """Let it go on from a time, so many times as fast as real time, up to a limit."""

    def pause(self, at_ns: int) -> None:
        """Let it stand at a time."""

    def jump(self, at_ns: int) -> None:
        """Set it to a time that may lie before the one it shows, and let it stand there."""


class LogTime:
    """Where a playback stands in its log's time.

    Between jumps it never goes back. It runs at `rate`, and stands while it is paused or held; with rate None
    it stands, too, and goes from message to message. So does the run's clock; but in lockstep that goes from
    message to message always, and the rate only says how fast.

    Args:
        clock: the run's.
        monotonic_ns: real time.
        at_ns: where it begins.
        rate: times real time; None: it goes from message to message.
        paused: whether it stands at first.
        lockstep: whether the run is in lockstep.
    """

    def __init__(
        self,
        clock: ClockDriver,
        monotonic_ns: Callable[[], int],
        at_ns: int,
        rate: float | None,
        *,
        paused: bool = False,
        lockstep: bool = False,
    ):
        self._clock = clock
        self._monotonic_ns = monotonic_ns
        self._at_ns = at_ns
        self._since_ns = monotonic_ns()
        self._rate = rate
        self._paused = paused
        self._lockstep = lockstep
        self._held = False
        clock.pause(at_ns)
        self._drive()

    @property
    def position_ns(self) -> int:
        """The log's time now."""
        if not self.runs:
            return self._at_ns
        assert self._rate is not None
        return self._at_ns + round(min(self._monotonic_ns() - self._since_ns, LEASE_NS) * self._rate)

    @property
    def runs(self) -> bool:
        """Whether it goes on by itself."""
        return self._rate is not None and not self._paused and not self._held

    @property
    def rate(self) -> float | None:
        """Times real time; None: it goes from message to message."""
        return self._rate

    @rate.setter
    def rate(self, rate: float | None) -> None:
        self._freeze()
        self._rate = rate
        self._drive()

    @property
    def paused(self) -> bool:
        """Whether somebody has asked it to stand."""
        return self._paused

    @paused.setter
    def paused(self, paused: bool) -> None:
        self._freeze()
        self._paused = paused
        self._drive()

    @property
    def held(self) -> bool:
        """Whether it stands because the next message cannot be sent yet."""
        return self._held

    @held.setter
    def held(self, held: bool) -> None:
        if held != self._held:
            self._freeze()
            self._held = held
            self._drive()

    def renew(self) -> None:
        """Say that whoever plays the log is there."""
        if self.runs:
            self._freeze()
            self._drive()

    def advance_to(self, to_ns: int) -> None:
        """Go on to the time of what happens now, if that is later."""
        if not self.runs and to_ns > self._at_ns:
            self._at_ns = to_ns
            self._drive()
        if self._lockstep:
            self._clock.pause(to_ns)

    def jump(self, to_ns: int) -> None:
        """Go to any time of the log."""
        self._at_ns, self._since_ns = to_ns, self._monotonic_ns()
        self._clock.jump(to_ns)
        self._drive()

    def _freeze(self) -> None:
        self._at_ns, self._since_ns = self.position_ns, self._monotonic_ns()

    def _drive(self) -> None:
        if self._lockstep:
            return
        if self.runs:
            assert self._rate is not None
            self._clock.play(self._at_ns, self._rate, self._at_ns + round(LEASE_NS * self._rate))
        else:
            self._clock.pause(self._at_ns)
