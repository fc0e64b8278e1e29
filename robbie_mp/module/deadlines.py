"""Watches input that must keep coming; see `Module.subscribe`."""

from collections.abc import Callable
from dataclasses import dataclass

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.module.bus import Bus
from robbie_mp.module.calls.due import NEVER_NS, Due
from robbie_mp.module.clock import Clock, follows_machine, is_span
from robbie_mp.module.health import Health

LOOK_NS = 100_000_000
"""Longest time between two looks at input that is late, or by a clock whose rate may change at any time."""


class InvalidDeadline(RobbieError, ValueError):
    """A subscription has a deadline that cannot be kept.

    Example scenarios:
      - `deadline_s` is 0, negative, longer than 30 years, or NaN
      - there is an `on_late`, but no `deadline_s`
    """


@dataclass
class _Input:
    """A subscription whose messages must keep coming."""

    name: ChannelName
    what: str
    deadline_ns: int
    on_late: Callable[[], None]
    is_optional: bool
    stamp_ns: int = -1
    """When its newest message was published, by the machine's clock."""
    newest_ns: int | None = None
    """The same by the module's clock; before the first message, the time from which on it is awaited."""
    is_late: bool = False
    latenesses: int = 0
    greatest_age_ns: int = 0


class Deadlines:
    """Calls `on_late` for input that has not come in time.

    A message costs no more than its stamp: the newest ones are only looked at when one may be late.

    Args:
        bus: the module's bus.
        clock: the module's clock.
        health: gets to know what is late.
        due: brought forward to when there is something to look at, by the machine's clock.
    """

    def __init__(self, bus: Bus, clock: Clock, health: Health, due: Due):
        self._bus = bus
        self._clock = clock
        self._health = health
        self._due = due
        self._inputs: list[_Input] = []
        self._has_begun = False
        self._jumps = 0
        self._longest_wait_ns = NEVER_NS if follows_machine(clock) else LOOK_NS
        self.due_ns = NEVER_NS
        """When `look` has something to do, by the machine's clock."""

    def __len__(self) -> int:
        """Return the number of subscriptions with a deadline."""
        return len(self._inputs)

    def add(
        self,
        name: ChannelName,
        what: str,
        deadline_s: float,
        on_late: Callable[[], None] | None,
        *,
        is_optional: bool,
    ) -> None:
        """Watch a subscription.

        Args:
            name: names it for the bus.
            what: names its messages in the log.
            deadline_s: see `Module.subscribe`.
            on_late: called when a message is late; it may do anything that a tick may do.
            is_optional: whether to await its first message for any time.
        """
        deadline_ns = round(deadline_s * 1e9)
        watched = _Input(name, what, deadline_ns, on_late or (lambda: None), is_optional)
        self._inputs.append(watched)
        self._bus.show_deadline(name, deadline_ns, 0, 0)
        if self._has_begun:
            self._await(watched)
            self._look_at(self._bus.peers.now_ns())

    def begin(self) -> None:
        """Await all messages from now on: all modules are ready, or the clock has been set."""
        self._has_begun = True
        self._jumps = self._clock.jumps
        for watched in self._inputs:
            self._await(watched)
        if self._inputs:
            self._look_at(self._bus.peers.now_ns())

    def look(self) -> None:
        """Look at all inputs, by the module's clock."""
        if not self._inputs or not self._has_begun:
            return
        if self._jumps != self._clock.jumps:
            self.begin()
        left_ns = min([self._check(watched) for watched in self._inputs])
        self._look_at(self._bus.peers.now_ns() + max(1, left_ns))

    def _look_at(self, machine_ns: int) -> None:
        self.due_ns = machine_ns
        self._due.bring_forward(machine_ns)

    def _await(self, watched: _Input) -> None:
        watched.stamp_ns = max(watched.stamp_ns, self._bus.newest_stamp_ns(watched.name))
        if not watched.is_optional or watched.newest_ns is not None:
            watched.newest_ns = self._clock.monotonic_ns()

    def _check(self, watched: _Input) -> int:
        """Look at one input; return how long not to look at it again, in ns of the machine."""
        now_ns, stamp_ns = self._clock.monotonic_ns(), self._bus.newest_stamp_ns(watched.name)
        if stamp_ns > watched.stamp_ns:
            self._note_newest(watched, stamp_ns)
        if watched.newest_ns is None:
            return LOOK_NS
        age_ns = now_ns - watched.newest_ns
        if age_ns >= watched.deadline_ns:
            self._note_late(watched, age_ns)
            return min(LOOK_NS, watched.deadline_ns // 2)
        if watched.is_late:
            watched.is_late = False
            self._health.recover(watched.what, f"{watched.what} comes again")
        left_s = self._clock.machine_s_until(watched.newest_ns + watched.deadline_ns)
        return round(min(left_s * 1e9, self._longest_wait_ns))

    def _note_newest(self, watched: _Input, stamp_ns: int) -> None:
        newest_ns = self._clock.at(stamp_ns)
        if watched.is_late and watched.newest_ns is not None:
            self._note_age(watched, newest_ns - watched.newest_ns)
        watched.stamp_ns, watched.newest_ns = stamp_ns, newest_ns

    def _note_late(self, watched: _Input, age_ns: int) -> None:
        begins = not watched.is_late
        watched.is_late = True
        watched.latenesses += begins
        self._note_age(watched, age_ns)
        self._health.degrade(watched.what, f"no {watched.what} for {age_ns / 1e9:.1f} s")
        if begins:
            watched.on_late()

    def _note_age(self, watched: _Input, age_ns: int) -> None:
        watched.greatest_age_ns = max(watched.greatest_age_ns, age_ns)
        self._bus.show_deadline(
            watched.name, watched.deadline_ns, watched.latenesses, watched.greatest_age_ns
        )


def check_deadline(deadline_s: float | None, on_late: Callable[[], None] | None) -> None:
    """Check the deadline of a subscription.

    Raises:
        InvalidDeadline: it is not a positive time, or missing although there is an `on_late`.
    """
    if deadline_s is None:
        if on_late is not None:
            raise InvalidDeadline("on_late is never called without a deadline_s; give both")
    elif not is_span(deadline_s):
        raise InvalidDeadline(f"deadline_s is {deadline_s}; give a time greater than 0, at most 1e9, in s")
