"""ROS's time as the run's: `/clock`, which a simulator or a playback of ROS sends, sets the run's clock.

It is set in the threads of the middleware, because modules have no ticks before the run's time has begun.

Between two messages the run's time goes on at the rate of the last ones, but only a little further than the
next one is expected to say. So it stands still soon after the simulator is paused, or has died.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Protocol

from robbie_mp.messages import Message, MessageError, TimeJump
from robbie_mp.messages.stock.builtin_interfaces import Time
from robbie_mp.run.run_clock import MAX_RATE

LOST_S: Final = 1.0
"""After this time of the machine without a message, the time is lost."""
WINDOW_NS: Final = 1_000_000_000
"""The rate is that of the messages of this time of the machine."""
MAX_IN_WINDOW: Final = 64
AHEAD: Final = 1.5
"""How far the time may go beyond a message, in steps from one message to the next."""
FIRST_AHEAD_NS: Final = 10_000_000
LEAP_NS: Final = 10_000_000_000
"""A step that is longer than the machine's time at this rate by more than this is a jump."""
SECOND_NS: Final = 1_000_000_000
JUMP_NS: Final = 500_000_000
"""Least time of the machine between two jumps."""
TOLERANCE_NS: Final = 1_000_000_000
"""How much earlier than the clock of a bridge that died the next process may find ROS's time."""


class SettableClock(Protocol):
    """Sets the run's clock; see `robbie_mp.run.run_clock.ClockWriter`."""

    @property
    def now_ns(self) -> int | None:
        """The run's time; None if it has not begun."""

    def play(self, at_ns: int, rate: float, limit_ns: int) -> None:
        """Let time continue."""

    def pause(self, at_ns: int) -> None:
        """Stop time."""

    def jump(self, at_ns: int) -> None:
        """Set another time."""


class _Seen(NamedTuple):
    """A message on /clock."""

    machine_ns: int
    at_ns: int


@dataclass
class RosTime:
    """Sets the run's clock by the messages on /clock.

    Args:
        clock: the run's clock.
        monotonic_ns: the machine's time.

    Attributes:
        announced: jumps of the time that the module is to publish.
        jumps: how often the time was reset, or has leapt.
        malformed: messages that are none.
        ignored: messages of other publishers than the one that is followed, and further jumps soon after one.
    """

    clock: SettableClock
    monotonic_ns: Callable[[], int] = time.monotonic_ns
    announced: "deque[TimeJump]" = field(default_factory=lambda: deque(maxlen=MAX_IN_WINDOW))
    jumps: int = 0
    malformed: int = 0
    ignored: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _seen: "deque[_Seen]" = field(default_factory=lambda: deque(maxlen=MAX_IN_WINDOW))
    _heard_ns: int = 0
    """When the last message came, by the machine's clock; before the first, when this began."""

    _jumped_ns: int = -JUMP_NS
    _source: bytes | None = None
    """The publisher that is followed: the first, until it has been silent for LOST_S."""

    def __post_init__(self) -> None:
        self._heard_ns = self.monotonic_ns()

    @property
    def problem(self) -> str:
        """Why the run's time is not ROS's; "" if it is."""
        if (self.monotonic_ns() - self._heard_ns) * 1e-9 < LOST_S:
            return ""
        if self.clock.now_ns is None:
            return "nobody has sent a time on /clock yet, and the run waits for it"
        return "no message on /clock: the run's time stands still, and nothing may move"

    @property
    def rate(self) -> float:
        """How fast ROS's time goes, in s per second of the machine; 0 if it stands, or it is not known."""
        if len(self._seen) < 2:
            return 0.0
        first, last = self._seen[0], self._seen[-1]
        took_ns = last.machine_ns - first.machine_ns
        return min(MAX_RATE, (last.at_ns - first.at_ns) / took_ns) if took_ns > 0 else 0.0

    def take(self, clock: type[Message], data: bytes, machine_ns: int, sender: bytes = b"") -> None:
        """Take a message, of which nothing was checked.

        Args:
            clock: its type.
            data: the message.
            machine_ns: when it came, by the machine's clock.
            sender: its publisher.
        """
        try:
            told: Any = clock.decode(data)
        except MessageError:
            self.malformed += 1
            return
        sec, nanosec = told.clock.sec, told.clock.nanosec
        if sec < 0 or nanosec >= SECOND_NS:
            self.malformed += 1
            return
        with self._lock:
            is_silent = (machine_ns - self._heard_ns) * 1e-9 >= LOST_S
            if self._source not in (None, sender) and not is_silent:
                self.ignored += 1
                return
            self._source = sender
            self.see(sec * SECOND_NS + nanosec, machine_ns)

    def see(self, at_ns: int, machine_ns: int) -> None:
        """Take the time of a message.

        Args:
            at_ns: the time in it.
            machine_ns: when it came, by the machine's clock.
        """
        before_ns = self._before_ns()
        if before_ns is None or at_ns < before_ns or self._leaps(at_ns, machine_ns):
            if before_ns is not None and machine_ns - self._jumped_ns < JUMP_NS:
                self.ignored += 1
            else:
                self._heard_ns = self._jumped_ns = machine_ns
                self._jump(at_ns, machine_ns)
            return
        self._heard_ns = machine_ns
        last = self._seen[-1] if self._seen else None
        if last is not None and at_ns == last.at_ns:  # paused: what was before tells no rate
            self._seen.clear()
            self._seen.append(_Seen(machine_ns, at_ns))
            self.clock.pause(at_ns)
            return
        self._seen.append(_Seen(machine_ns, at_ns))
        while len(self._seen) > 2 and machine_ns - self._seen[0].machine_ns > WINDOW_NS:
            self._seen.popleft()
        self._go_on(at_ns)

    def _before_ns(self) -> int | None:
        """Return the earliest time that goes on with what was; None if nothing was."""
        if self._seen:
            return self._seen[-1].at_ns
        now_ns = self.clock.now_ns
        return None if now_ns is None else max(0, now_ns - TOLERANCE_NS)

    def _leaps(self, at_ns: int, machine_ns: int) -> bool:
        if not self._seen:
            return at_ns - (self.clock.now_ns or 0) > LEAP_NS
        last = self._seen[-1]
        expected_ns = (machine_ns - last.machine_ns) * max(1.0, self.rate)
        return at_ns - last.at_ns - expected_ns > LEAP_NS

    def _jump(self, at_ns: int, machine_ns: int) -> None:
        before_ns = self.clock.now_ns
        self._seen.clear()
        self._seen.append(_Seen(machine_ns, at_ns))
        self.clock.jump(at_ns)
        if before_ns is not None:
            self.jumps += 1
            before, after = Time.from_nanoseconds(before_ns), Time.from_nanoseconds(at_ns)
            self.announced.append(TimeJump(before=before, after=after, reason="reset"))

    def _go_on(self, at_ns: int) -> None:
        """Let the time reach what the next message is expected to say when that is expected to come."""
        now_ns, rate = self.clock.now_ns or at_ns, self.rate
        if rate <= 0.0:
            self.clock.play(at_ns, 1.0, at_ns + FIRST_AHEAD_NS)
            return
        steps = len(self._seen) - 1
        step_ns = (self._seen[-1].at_ns - self._seen[0].at_ns) / steps
        begin_ns = max(at_ns, now_ns)
        left_ns = max(0.0, at_ns + step_ns - begin_ns)
        self.clock.play(begin_ns, min(MAX_RATE, rate * left_ns / step_ns), round(at_ns + AHEAD * step_ns))
