"""The health of a run's modules: what they say of themselves, and what their figures show."""

import time
from collections import deque
from collections.abc import Callable

from robbie_mp.bus.observe import ModuleFigures, RunObserver
from robbie_mp.bus.observe.connections import what
from robbie_mp.module.health import Health
from robbie_mp.run.supervisor.states import ChildState, state_name

LOOK_S = 1.0
WINDOW_S = 5.0
"""A module is judged by its figures of this time, so a problem ends when it was not seen for as long."""
LASTING_S = 5.0
"""A module that was DEGRADED for this time when the run began to stop has not done its work.

That it is slow does not count: that depends on what else the machine does.
"""
MANY_MISSED = 3
MISSED_SHARE = 0.2
"""A module that misses this many and this share of its ticks does not keep its period."""


def _drops(before: ModuleFigures, now: ModuleFigures) -> str:
    dropped = now.total("overflowed") - before.total("overflowed")
    if not dropped:
        return ""
    old = {(one.type_name, one.topic): one.overflowed for one in before.subscriptions}
    worst = max(now.subscriptions, key=lambda one: one.overflowed - old.get((one.type_name, one.topic), 0))
    came = now.total("routed") - before.total("routed")
    name = what(worst.type_name, worst.topic)
    return f"{dropped} of {max(came, dropped)} messages dropped because it was too slow ({name})"


def _refused(before: ModuleFigures, now: ModuleFigures) -> str:
    refused = now.refused - before.refused
    return f"{refused} of its messages refused because its memory or a table was full" if refused else ""


def _copies(before: ModuleFigures, now: ModuleFigures) -> str:
    copied = now.copied - before.copied
    kept = f"{now.pinned} messages of others ({now.pinned_bytes / 1e6:.1f} MB)"
    return f"{copied} messages copied into its own memory because it keeps {kept}" if copied > 0 else ""


def _missed(before: ModuleFigures, now: ModuleFigures) -> str:
    missed = 0 if now.ticks_wait else now.ticks_missed - before.ticks_missed
    due = missed + now.ticks - before.ticks
    return f"{missed} of {due} ticks missed" if missed >= MANY_MISSED and missed > MISSED_SHARE * due else ""


PROBLEMS = {"drops": _drops, "refused": _refused, "copies": _copies, "ticks": _missed}
"""What a module's figures may show. Each returns what went wrong between two moments; '' if nothing did."""

SLOW = {"copies", "ticks"}
ENDING = ("tick", "handler")
"""The activities that should end soon."""


class _Watched:
    """One module.

    Args:
        health: says and shows what its figures show.

    Attributes:
        reason: why it is DEGRADED, also by what it says itself; '': it is OK.
        fails_since_s: since when it has other reasons than that it is slow; None: it has none.
    """

    def __init__(self, health: Health):
        self.reason = ""
        self.fails_since_s: float | None = None
        self._health = health
        self._window: deque[tuple[float, ModuleFigures]] = deque()
        self._began: dict[str, ModuleFigures] = {}
        """For each present problem: the figures before it."""
        self._busy_since_ns = 0
        self._busy_seen_s = 0.0
        """When its present activity was first seen."""

    def look(self, now_s: float, now: ModuleFigures) -> None:
        """Judge its figures."""
        if self._window and self._window[-1][1].incarnation != now.incarnation:
            self.forget()
        while self._window and now_s - self._window[0][0] > WINDOW_S:
            self._window.popleft()
        self._window.append((now_s, now))
        # The reasons that were known when these figures were read are the ones of the last look.
        is_only_slow = now.health == self._health.line and self._began.keys() <= SLOW
        if is_only_slow:
            self.fails_since_s = None
        elif self.fails_since_s is None:
            self.fails_since_s = now_s
        for cause, problem in PROBLEMS.items():
            self._update(cause, problem, self._window[0][1], now)
        self._judge_activity(now_s, now)
        self.reason = now.health

    def forget(self) -> None:
        """Forget everything: its process has ended."""
        self._window.clear()
        self._began.clear()
        self._health.clear()
        self.reason = ""
        self.fails_since_s = None

    def _judge_activity(self, now_s: float, now: ModuleFigures) -> None:
        """Say when a tick or handler does not end."""
        if now.busy_since_ns != self._busy_since_ns:
            self._busy_since_ns, self._busy_seen_s = now.busy_since_ns, now_s
        busy_s = now_s - self._busy_seen_s
        if now.busy_since_ns and busy_s >= WINDOW_S and now.activity in ENDING:
            what_runs = f"handler {now.handler}" if now.handler else now.activity
            self._health.degrade("stuck", f"its {what_runs} has not ended for {busy_s:.0f} s")
        else:
            self._health.recover("stuck")

    def _update(
        self,
        cause: str,
        problem: Callable[[ModuleFigures, ModuleFigures], str],
        before: ModuleFigures,
        now: ModuleFigures,
    ) -> None:
        if reason := problem(before, now):
            self._began.setdefault(cause, before)
            self._health.degrade(cause, reason)
        elif began := self._began.pop(cause, None):
            whole = problem(began, now)
            self._health.recover(cause, f"after {whole}" if whole else "")


class HealthWatch:
    """Judges the figures of all modules once a second, and knows which are DEGRADED.

    Args:
        observer: reads the run.
        say: writes an entry about a module, as a warning.
        show: shows on the board why a module's figures make it DEGRADED.
        modules: names of the modules to watch.
        clock: monotonic time in s.
    """

    def __init__(
        self,
        observer: RunObserver,
        say: Callable[[str, str], None],
        show: Callable[[str, str], None],
        modules: list[str],
        clock: Callable[[], float] = time.monotonic,
    ):
        self._observer = observer
        self._clock = clock
        self._next_s = self._looked_s = clock()
        self._states: dict[str, str] = {}
        self._watched = {name: _watched(name, say, show) for name in modules}

    def turn(self) -> None:
        """Look, if it is time for that. Do not call this while the run stops: then nothing is as it was."""
        if (now_s := self._clock()) < self._next_s:
            return
        self._next_s, self._looked_s = now_s + LOOK_S, now_s
        for figures in self._observer.modules(only_counts=True):
            if watched := self._watched.get(figures.name):
                state = self._states[figures.name] = state_name(figures.state)
                watched.look(now_s, figures) if state == ChildState.RUNNING else watched.forget()

    @property
    def lasting(self) -> dict[str, str]:
        """Why modules are DEGRADED, by name: those that had been for `LASTING_S` at the last look."""
        return {
            name: one.reason
            for name, one in self._watched.items()
            if one.fails_since_s is not None and self._looked_s - one.fails_since_s >= LASTING_S
        }

    @property
    def summary(self) -> str:
        """One line on all modules."""
        troubled = [f"{name} is DEGRADED: {one.reason}" for name, one in self._watched.items() if one.reason]
        ended = [
            f"{name} is {state}" for name, state in self._states.items() if state in ("FAILED", "BACKOFF")
        ]
        return "; ".join([*ended, *troubled]) or f"{len(self._watched)} modules run"


def _watched(name: str, say: Callable[[str, str], None], show: Callable[[str, str], None]) -> _Watched:
    return _Watched(Health(lambda text: say(name, text), lambda line: show(name, line)))
