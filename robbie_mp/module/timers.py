"""Functions that a module calls periodically, besides its `tick()`; see `Module.every`."""

import math
import time
from collections.abc import Callable

from robbie_mp.base.errors import RobbieError
from robbie_mp.module.bus import Bus
from robbie_mp.module.calls.due import NEVER_NS, Due
from robbie_mp.module.clock import Clock, follows_machine, is_span
from robbie_mp.module.handlers import check_handler

LOOK_NS = 20_000_000
"""Longest time between two looks at a clock whose rate may change at any time."""
MAX_GRANTS_PER_PERIOD = 10
"""In lockstep, time passes in steps of at least the shortest period divided by this number."""


class InvalidTimer(RobbieError, ValueError):
    """A function cannot be called with this period.

    Example scenarios:
      - the period is 0, negative, longer than 30 years, or NaN
      - period and function are given in the wrong order
    """


class Timer:
    """One function that is called periodically.

    Attributes:
        period_ns: the time between two calls.
        action: the function.
        due_ns: time of the next call by the module's clock.
        is_active: False after `stop`.
    """

    def __init__(self, period_ns: int, action: Callable[[], object], due_ns: int):
        self.period_ns = period_ns
        self.action = action
        self.due_ns = due_ns
        self.is_active = True

    def stop(self) -> None:
        """Do not call the function any more."""
        self.is_active = False

    def schedule(self, now_ns: int) -> int:
        """Set when the next call is due; return how many calls are skipped, because they are late."""
        self.due_ns += self.period_ns
        missed = max(0, (now_ns - self.due_ns) // self.period_ns)
        self.due_ns += missed * self.period_ns
        return missed


def _count_nothing(_late_ns: int, _begun_ns: int, _missed: int) -> None:
    """Count no call: nobody reads the figures."""


class Timers:
    """Calls a module's functions when they are due, by the module's clock.

    Args:
        bus: the module's bus.
        clock: the module's clock.
        due: brought forward to when there is something to do, by the machine's clock.

    Attributes:
        count: counts a call as a tick: how late it began, when (ns of the machine), and the calls skipped.
    """

    def __init__(self, bus: Bus, clock: Clock, due: Due):
        self._bus = bus
        self._clock = clock
        self._due = due
        self._timers: list[Timer] = []
        self._has_begun = False
        self._jumps = 0
        self._longest_wait_ns = NEVER_NS if follows_machine(clock) else LOOK_NS
        self.count: Callable[[int, int, int], None] = _count_nothing
        self.due_ns = NEVER_NS
        """When `run` has something to do, by the machine's clock."""

    def __len__(self) -> int:
        """Return the number of functions that are called."""
        return len(self._timers)

    def add(self, period_s: float, action: Callable[[], object]) -> Timer:
        """Call a function periodically, from now on, or from the module's beginning.

        Raises:
            InvalidTimer, InvalidHandler: period or function cannot be used.
        """
        check_timer(period_s, action)
        timer = Timer(max(1, round(period_s * 1e9)), action, self._clock.monotonic_ns())
        self._timers.append(timer)
        if self._has_begun:
            self._look_at(self._bus.peers.now_ns())
        return timer

    def begin(self) -> None:
        """Make the first call of all functions due now: all modules are ready, or the clock has been set."""
        self._has_begun = True
        self._jumps = self._clock.jumps
        for timer in self._timers:
            timer.due_ns = self._clock.monotonic_ns()
        if self._timers:
            self._look_at(self._bus.peers.now_ns())

    def run(self) -> None:
        """Call the functions that are due, the one that is due first before the others."""
        if not self._timers or not self._has_begun:
            return
        if self._jumps != self._clock.jumps:
            self.begin()
        now_ns = self._clock.monotonic_ns()
        for timer in sorted(self._timers, key=lambda timer: timer.due_ns):
            if timer.is_active and timer.due_ns <= now_ns:
                self._call(timer)
        self._timers = [timer for timer in self._timers if timer.is_active]
        self._look_at(self._next_ns())

    def _call(self, timer: Timer) -> None:
        late_ns, begun_ns = self._clock.monotonic_ns() - timer.due_ns, time.monotonic_ns()
        timer.action()
        self.count(late_ns, begun_ns, timer.schedule(self._clock.monotonic_ns()))

    def _next_ns(self) -> int:
        """Return when to look again, by the machine's clock."""
        if not self._timers:
            return NEVER_NS
        left_s = self._clock.machine_s_until(min(timer.due_ns for timer in self._timers))
        return self._bus.peers.now_ns() + round(min(left_s * 1e9, self._longest_wait_ns))

    def _look_at(self, machine_ns: int) -> None:
        self.due_ns = machine_ns
        self._due.bring_forward(machine_ns)

    def step_ns(self, tick_period_ns: int) -> int:
        """Return the steps in which time must pass in lockstep, so that every call comes in time.

        Args:
            tick_period_ns: the period of the module's ticks; 0: it has none.
        """
        periods = [timer.period_ns for timer in self._timers] + [tick_period_ns] * (tick_period_ns > 0)
        return max(math.gcd(*periods), min(periods) // MAX_GRANTS_PER_PERIOD)


def check_timer(period_s: object, action: object) -> None:
    """Check what is given to `Module.every`.

    Raises:
        InvalidTimer: the period is no positive time.
        InvalidHandler: the function cannot be called without arguments.
    """
    if not is_span(period_s):
        raise InvalidTimer(
            f"every: the period is {period_s!r:.60}; give a time greater than 0, at most 1e9, in s"
        )
    check_handler("every", action)
