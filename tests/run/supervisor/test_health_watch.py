"""The supervisor judges modules by their figures: when trouble begins, when it ends, and what it is."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from robbie_mp.bus.observe import ModuleFigures
from robbie_mp.run.supervisor.health_watch import LASTING_S, WINDOW_S, HealthWatch
from robbie_mp.run.supervisor.states import STATES, ChildState
from tests.cli._support.readings import mapping


class Watch:
    """A watch of one module whose figures a test sets."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.figures = replace(mapping(0.0), name="mapping", health="")
        self.said: list[str] = []
        self.shown = ""
        observer: Any = SimpleNamespace(modules=self._modules)
        self.watch = HealthWatch(
            observer, lambda _name, text: self.said.append(text), self._show, ["mapping"], lambda: self.now_s
        )
        self.watch.turn()

    def _modules(self, *, only_counts: bool) -> list[ModuleFigures]:
        return [replace(self.figures, health="; ".join(filter(None, (self.figures.health, self.shown))))]

    def _show(self, _name: str, line: str) -> None:
        self.shown = line

    def pass_s(self, time_s: int, change: Callable[[ModuleFigures], ModuleFigures] = lambda one: one) -> None:
        """Let time pass; each second the figures change."""
        for _ in range(time_s):
            self.now_s += 1.0
            self.figures = change(self.figures)
            self.watch.turn()


def dropping(one: ModuleFigures) -> ModuleFigures:
    first, *rest = one.subscriptions
    return replace(
        one, subscriptions=(replace(first, routed=first.routed + 10, dropped=first.dropped + 6), *rest)
    )


def missing_ticks(one: ModuleFigures) -> ModuleFigures:
    return replace(one, ticks=one.ticks + 6, ticks_missed=one.ticks_missed + 4)


def test_dropped_messages_are_one_line_at_the_beginning_and_the_sum_at_the_end() -> None:
    watch = Watch()
    watch.pass_s(20, dropping)
    name = "messages dropped because it was too slow (sensor_msgs/LaserScan"
    assert len(watch.said) == 1
    assert watch.said[0].startswith(f"DEGRADED: 6 of 10 {name}")
    assert watch.shown.startswith(f"30 of 50 {name}"), "those of the last 5 s"
    assert watch.watch.summary.startswith("mapping is DEGRADED: 30 of 50")
    watch.pass_s(round(WINDOW_S) + 1)
    assert len(watch.said) == 2
    assert watch.said[1].startswith(f"OK again: after 120 of 200 {name}")
    assert watch.shown == ""
    assert watch.watch.summary == "1 modules run"


def test_a_few_missed_ticks_are_no_trouble_and_many_are() -> None:
    watch = Watch()
    watch.pass_s(20, lambda one: replace(one, ticks=one.ticks + 9, ticks_missed=one.ticks_missed + 1))
    assert not watch.said
    watch.pass_s(10, missing_ticks)
    assert len(watch.said) == 1
    assert "ticks missed" in watch.said[0]
    watch = Watch()
    watch.figures = replace(watch.figures, ticks_wait=True)
    watch.pass_s(20, missing_ticks)
    assert not watch.said, "its ticks wait for a device"


def test_tick_that_does_not_end_is_one_line_and_does_not_fail_the_run() -> None:
    watch = Watch()
    watch.figures = replace(watch.figures, busy_since_ns=7, activity="tick", handler="")
    watch.pass_s(round(WINDOW_S))
    assert not watch.said
    watch.pass_s(10)
    assert watch.said == ["DEGRADED: its tick has not ended for 5 s"]
    assert watch.shown == "its tick has not ended for 14 s"
    assert not watch.watch.lasting
    watch.pass_s(10, lambda one: replace(one, busy_since_ns=one.busy_since_ns + 1))  # short ones
    assert watch.said[1:] == ["OK again (it was: its tick has not ended for 14 s)"]


@pytest.mark.parametrize(("change", "fails"), [(dropping, True), (missing_ticks, False)])
def test_slow_module_does_not_fail_the_run_and_one_that_drops_messages_does(
    change: Callable[[ModuleFigures], ModuleFigures], fails: bool
) -> None:
    watch = Watch()
    watch.pass_s(3, change)
    assert watch.shown
    assert not watch.watch.lasting
    watch.pass_s(round(LASTING_S) + 2, change)
    assert bool(watch.watch.lasting) is fails


def test_module_that_says_so_itself_fails_the_run_until_it_is_well() -> None:
    watch = Watch()
    watch.figures = replace(watch.figures, health="it is unplugged")
    watch.pass_s(round(LASTING_S) + 1)
    assert watch.watch.lasting == {"mapping": "it is unplugged"}
    watch.figures = replace(watch.figures, health="")
    watch.pass_s(1)
    assert watch.watch.lasting == {}


def test_end_of_a_process_ends_its_trouble_without_a_word() -> None:
    watch = Watch()
    watch.pass_s(8, dropping)
    watch.pass_s(1, lambda one: replace(one, state=STATES.index(ChildState.BACKOFF) + 1, pid=0))
    assert (len(watch.said), watch.shown) == (1, "")
    assert watch.watch.summary == "mapping is BACKOFF"
    watch.pass_s(2, lambda one: replace(one, state=STATES.index(ChildState.RUNNING) + 1, incarnation=2))
    assert (len(watch.said), watch.watch.lasting) == (1, {})
