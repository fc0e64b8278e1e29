"""Decides when a module's `tick()` is due: by a clock, or when the module that turns the clock grants it."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.histogram import WorkFigures
from robbie_mp.bus.transport.history import Event
from robbie_mp.bus.transport.records import MessageHandling
from robbie_mp.bus.transport.words import Words
from robbie_mp.messages import Tick
from robbie_mp.module.clock import Clock
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.module import Module, calls_of

MAX_WAIT_S = 0.5
"""Even an idle module wakes up this often, to release arrays that other threads held, and for signals."""
MAX_RUN_CLOCK_WAIT_S = 0.02
"""The same for a module that ticks by a clock whose rate may change at any time."""


CALL_TICK_PERIOD_NS = 50_000_000
"""Period of the ticks granted to a module without a period while its calls or deadlines need them."""


@dataclass(slots=True)
class TickTimes:
    """When the next tick of a module is due, and how many there were; C has a class of the same name.

    Attributes:
        due_ns: time of the next tick by the module's clock, in ns.
        ticks: number of ticks so far.
        missed: number of ticks that were skipped.
    """

    due_ns: int = 0
    ticks: int = 0
    missed: int = 0


class TimedTicks:
    """Ticks every `period_s` of a clock. Ticks that were missed altogether are skipped and counted.

    Args:
        module: the module that ticks.
        clock: times the ticks.
        words: the module's out segment, for the counters; None: nobody reads them.
        max_wait_s: longest time between two looks at the clock.
        native: what is written in C; None: Python does it.
    """

    def __init__(
        self,
        module: Module,
        clock: Clock,
        words: Words | None = None,
        max_wait_s: float = MAX_WAIT_S,
        native: Native | None = None,
    ):
        self._module = module
        self._clock = clock
        self._now_ns = clock.monotonic_ns
        self._words = words
        self._max_wait_s = max_wait_s
        self._figures = None if words is None else WorkFigures(words, layout.OUT_TICK_FIGURES)
        times: Any = TickTimes() if native is None else native.TickTimes()
        self.times: TickTimes = times
        self._jumps = 0

    @property
    def follow_the_machine(self) -> bool:
        """Whether they follow the machine's own clock, which C reads."""
        return self._now_ns is time.monotonic_ns

    def begin(self) -> None:
        """Make the first tick due now."""
        self._jumps = self._clock.jumps
        self.expedite()

    def expedite(self) -> None:
        """Make the next tick due now."""
        self.times.due_ns = self._now_ns()

    def are_due(self) -> bool:
        """Whether it is time for a tick."""
        if self._module.period_s is None:
            return False
        if self._jumps != self._clock.jumps:
            self.begin()
        return self._now_ns() >= self.times.due_ns

    def wait_s(self) -> float:
        """Return how long to wait for messages before the next tick, in s."""
        if self._module.period_s is None:
            return MAX_WAIT_S
        return min(self._max_wait_s, self._clock.machine_s_until(self.times.due_ns))

    def run(self) -> None:
        """Tick, and set when the next tick is due."""
        late_ns, begun_ns = self._now_ns() - self.times.due_ns, time.monotonic_ns()
        self._module.tick()
        self.count(late_ns, begun_ns)
        self.schedule()

    def count(self, late_ns: int, begun_ns: int, missed: int = 0) -> None:
        """Count a tick, or the call of a timer, that has just ended.

        Args:
            late_ns: how late it began.
            begun_ns: when, by the machine's clock.
            missed: the number of calls that are skipped.
        """
        if self._figures is not None:
            self._figures.record(late_ns, time.monotonic_ns() - begun_ns)
        self.times.ticks += 1
        self._show(layout.OUT_TICKS, self.times.ticks)
        if missed:
            self._miss(missed)

    def _miss(self, missed: int) -> None:
        self.times.missed += missed
        self._show(layout.OUT_TICKS_MISSED, self.times.missed)

    def _show(self, at: int, count: int) -> None:
        if self._words is not None:
            self._words[at] = count

    def schedule(self) -> None:
        """Set when the next tick is due, and count those that are skipped."""
        if self._module.period_s is None:
            return
        times = self.times
        period_ns = round(self._module.period_s * 1e9)
        times.due_ns += period_ns
        behind_ns = self._now_ns() - times.due_ns
        if behind_ns > period_ns:
            missed = behind_ns // period_ns
            times.due_ns += missed * period_ns
            self._miss(missed)


class GrantedTicks:
    """Ticks granted by messages from the module that turns the clock; see `robbie_mp.run.lockstep`.

    Args:
        module: the module that ticks.
        words: the module's out segment, which shows its period.
        inbox: receives the grants.
        now_ns: returns the run's time.
        charge: makes of the measured time of a handler, in ns, the time for which the module is busy by the
            run's clock; None: handlers take no time of the run.
        record: adds an event to the module's history.
    """

    def __init__(
        self,
        module: Module,
        words: Words,
        inbox: Inbox,
        now_ns: Callable[[], int],
        charge: Callable[[int], int] | None = None,
        record: Callable[..., None] = lambda *_event: None,
    ):
        self._module = module
        self._record = record
        self._words = words
        self._now_ns = now_ns
        self._charge = charge
        self._ticks = 0
        self._due_ns = 0
        """When the next tick is due, if there are grants between ticks."""
        self._calls = calls_of(module)
        self._calls.is_granted = True
        # A busy module skips ticks, as it does without lockstep.
        handling = MessageHandling.KEEP_ONLY_NEWEST if charge else MessageHandling.ALWAYS_DELIVER
        inbox.subscriptions.subscribe(Tick, self._on_tick, handling, module.name)
        inbox.before_release = self._end_handling

    def begin(self) -> None:
        """Show the period of the ticks; any handler may have changed it.

        A module without a period gets ticks, too, if it has timers or subscriptions with a deadline, and
        while calls of it have not ended: they may time out.
        """
        period_ns = self._period_ns()
        if len(self._calls.timers):
            period_ns = self._calls.timers.step_ns(period_ns)
        if not period_ns and (len(self._calls.client) or len(self._calls.deadlines)):
            period_ns = CALL_TICK_PERIOD_NS
        self._words[layout.OUT_TICK_PERIOD_NS] = period_ns

    def _period_ns(self) -> int:
        period_s = self._module.period_s
        return 0 if period_s is None else round(period_s * 1e9)

    def _end_handling(self) -> None:
        """Show what other processes must know once they see that a message was handled."""
        self._calls.end_handling()
        self.begin()
        if self._charge is not None:
            words = self._words
            measured_ns = time.monotonic_ns() - words[layout.OUT_ACTIVITY_SINCE_NS]
            words[layout.OUT_CHARGED_SINCE_NS] = self._now_ns()
            words[layout.OUT_CHARGED_NS] = self._charge(measured_ns)

    def _on_tick(self, _tick: Tick) -> None:
        self._record(Event.CALLS)
        self._calls.run_granted()
        if self._module.period_s is not None and self._is_due():
            self._record(Event.TICK)
            self._module.tick()
            self.count()

    def _is_due(self) -> bool:
        """Whether this grant is one for a tick, rather than one for the timers alone."""
        now_ns, period_ns = self._now_ns(), self._period_ns()
        if now_ns < self._due_ns <= now_ns + period_ns and len(self._calls.timers):
            return False
        is_on_time = now_ns - period_ns < self._due_ns <= now_ns
        self._due_ns = (self._due_ns if is_on_time else now_ns) + period_ns
        return True

    def count(self, _late_ns: int = 0, _begun_ns: int = 0, _missed: int = 0) -> None:
        """Count a tick, or the call of a timer: none is late in lockstep."""
        self._ticks += 1
        self._words[layout.OUT_TICKS] = self._ticks

    def expedite(self) -> None:
        """Do nothing: a tick runs when it is granted."""

    def are_due(self) -> bool:
        """Always False: the message that grants a tick runs it."""
        return False

    def wait_s(self) -> float:
        """Return how long to wait for messages, in s."""
        return MAX_WAIT_S

    def run(self) -> None:
        """Do nothing: see `are_due`."""


Ticks = TimedTicks | GrantedTicks
