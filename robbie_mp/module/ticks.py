"""When a module's `tick()` is due: by the run's clock, or whenever whoever turns it says so."""

import time
from typing import Protocol

from robbie_mp.messages import Tick
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.module import Module
from robbie_mp.transport import layout
from robbie_mp.transport.histogram import WorkFigures
from robbie_mp.transport.records import MessageHandling
from robbie_mp.transport.words import Words

LONGEST_WAIT_S = 0.5
"""Even an idle module looks up so often: for arrays that other threads have let go, and for signals."""
LONGEST_WAIT_BY_RUN_CLOCK_S = 0.02
"""Of a module that ticks by a clock whose rate may change at any time."""


class TickClock(Protocol):
    """What ticks are timed by."""

    @property
    def jumps(self) -> int:
        """How often the time has been set to another one."""

    def monotonic_ns(self) -> int:
        """The time."""

    def machine_s_until(self, monotonic_ns: int) -> float:
        """How long until it is so late."""


class TimedTicks:
    """Ticks every `period_s` of a clock. A time that has been missed altogether is skipped and counted.

    Args:
        module: whose ticks they are.
        clock: what they are timed by.
        words: the module's out segment, for the counters.
        longest_wait_s: look at the clock so often.
    """

    def __init__(self, module: Module, clock: TickClock, words: Words, longest_wait_s: float):
        self._module = module
        self._clock = clock
        self._now_ns = clock.monotonic_ns
        self._words = words
        self._longest_wait_s = longest_wait_s
        self._figures = WorkFigures(words, layout.OUT_TICK_FIGURES)
        self._ticks = 0
        self._missed = 0
        self._jumps = 0
        self._due_ns = 0

    def begin(self) -> None:
        """Have the first tick at once."""
        self._jumps = self._clock.jumps
        self.expedite()

    def expedite(self) -> None:
        """Have the next tick at once."""
        self._due_ns = self._now_ns()

    def are_due(self) -> bool:
        """Whether it is time for a tick."""
        if self._module.period_s is None:
            return False
        if self._jumps != self._clock.jumps:
            self.begin()
        return self._now_ns() >= self._due_ns

    def wait_s(self) -> float:
        """How long to wait for messages until then."""
        if self._module.period_s is None:
            return LONGEST_WAIT_S
        return min(self._longest_wait_s, self._clock.machine_s_until(self._due_ns))

    def run(self) -> None:
        """Tick, and say when the next one is due."""
        late_ns, begun_ns = self._now_ns() - self._due_ns, time.monotonic_ns()
        self._module.tick()
        self._figures.record(late_ns, time.monotonic_ns() - begun_ns)
        self._ticks += 1
        self._words[layout.OUT_TICKS] = self._ticks
        if self._module.period_s is None:
            return
        period_ns = round(self._module.period_s * 1e9)
        self._due_ns += period_ns
        behind_ns = self._now_ns() - self._due_ns
        if behind_ns > period_ns:
            missed = behind_ns // period_ns
            self._due_ns += missed * period_ns
            self._missed += missed
            self._words[layout.OUT_TICKS_MISSED] = self._missed


class GrantedTicks:
    """Ticks that come as messages, from the module that turns the clock; see `robbie_mp.run.lockstep`.

    Args:
        module: whose ticks they are.
        words: the module's out segment, where its period is shown.
        inbox: has the messages of its name handled.
    """

    def __init__(self, module: Module, words: Words, inbox: Inbox):
        self._module = module
        self._words = words
        self._ticks = 0
        inbox.subscriptions.subscribe(Tick, self._on_tick, MessageHandling.ALWAYS_DELIVER, module.name)
        inbox.before_release = self.begin  # any handler may have changed it

    def begin(self) -> None:
        """Show how often there are to be ticks."""
        period_s = self._module.period_s
        self._words[layout.OUT_TICK_PERIOD_NS] = 0 if period_s is None else round(period_s * 1e9)

    def _on_tick(self, _tick: Tick) -> None:
        if self._module.period_s is not None:
            self._module.tick()
            self._ticks += 1
            self._words[layout.OUT_TICKS] = self._ticks

    def expedite(self) -> None:
        """Do nothing: a tick comes when it is granted."""

    def are_due(self) -> bool:
        """Never by themselves."""
        return False

    def wait_s(self) -> float:
        """How long to wait for messages."""
        return LONGEST_WAIT_S

    def run(self) -> None:
        """Do nothing: see `are_due`."""


Ticks = TimedTicks | GrantedTicks
