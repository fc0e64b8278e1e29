"""The time of a log during playback, which also drives the run's clock."""

from collections.abc import Callable
from typing import Protocol

LATEST_NS = (1 << 31) * 1_000_000_000 - 1
"""The latest time that messages can express, in January 2038; the clock stays there for later ones."""
LEASE_NS = 250_000_000
"""Time stops this long after the last renewal: it does not advance without the player."""


class ClockDriver(Protocol):
    """Sets the run's clock; see `robbie_mp.run.run_clock.ClockWriter`."""

    def play(self, at_ns: int, rate: float, limit_ns: int) -> None:
        """Let the clock advance from a time, at a multiple of real time, up to a limit."""

    def pause(self, at_ns: int) -> None:
        """Stop the clock at a time."""

    def jump(self, at_ns: int) -> None:
        """Set the clock to a time, which may be earlier than the present one, and stop it there."""


class LogTime:
    """The position of a playback in its log's time.

    Between jumps the time never goes back. It advances at `rate`, and stops while it is paused or held. With
    rate None it does not advance either, but steps from message to message. The run's clock does the same; in
    lockstep, however, the clock always steps from message to message, and `rate` only sets how fast.

    Args:
        clock: the run's clock.
        monotonic_ns: real time.
        at_ns: the time at which it starts.
        rate: multiple of real time; None: it steps from message to message.
        paused: whether it starts paused.
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
        passed_ns = min(self._monotonic_ns() - self._since_ns, LEASE_NS)
        return min(self._at_ns + round(passed_ns * self._rate), LATEST_NS)

    @property
    def runs(self) -> bool:
        """Whether the time advances with real time."""
        return self._rate is not None and not self._paused and not self._held

    @property
    def rate(self) -> float | None:
        """Multiple of real time; None: it steps from message to message."""
        return self._rate

    @rate.setter
    def rate(self, rate: float | None) -> None:
        self._freeze()
        self._rate = rate
        self._drive()

    @property
    def paused(self) -> bool:
        """Whether a user has paused it."""
        return self._paused

    @paused.setter
    def paused(self, paused: bool) -> None:
        self._freeze()
        self._paused = paused
        self._drive()

    @property
    def held(self) -> bool:
        """Whether it is stopped because the next message cannot be sent yet."""
        return self._held

    @held.setter
    def held(self, held: bool) -> None:
        if held != self._held:
            self._freeze()
            self._held = held
            self._drive()

    def renew(self) -> None:
        """Confirm that the player is alive."""
        if self.runs:
            self._freeze()
            self._drive()

    def advance_to(self, to_ns: int) -> None:
        """Advance to the time of the present event, if that is later."""
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
            until_ns = min(self._at_ns + round(LEASE_NS * self._rate), LATEST_NS)
            self._clock.play(self._at_ns, self._rate, until_ns)
        else:
            self._clock.pause(self._at_ns)
