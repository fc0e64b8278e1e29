"""Functions that a module calls periodically, besides its ticks, by its own clock."""

import math
from typing import Any

import pytest

from robbie_mp import Module, ModuleHarness, Timer
from robbie_mp.messages import DriveCommand, LaserScan
from robbie_mp.module.calls.due import NEVER_NS, Due
from robbie_mp.module.clock import ManualClock
from robbie_mp.module.handlers import InvalidHandler
from robbie_mp.module.module import calls_of
from robbie_mp.module.timers import InvalidTimer, Timers


class Timed(Module):
    """Has two timers and ticks."""

    period_s = 0.25

    def setup(self) -> None:
        self.journal: list[tuple[int, str]] = []
        self.every(0.1, self.steer)
        self.slow: Timer = self.every(0.3, lambda: self.note("slow"))
        self.subscribe(LaserScan, self.on_scan)

    def note(self, what: str) -> None:
        self.journal.append((round(self.monotonic_s() * 1000), what))

    def steer(self) -> None:
        self.note("steer")
        self.publish(DriveCommand(header=self.header("base")))

    def tick(self) -> None:
        self.note("tick")

    def on_scan(self, _scan: LaserScan) -> None:
        self.slow.stop()
        self.every(0.2, lambda: self.note("later"))

    def times_ms(self, what: str) -> list[int]:
        return [ms for ms, one in self.journal if one == what]


def test_timers_run_beside_ticks_each_with_its_period() -> None:
    with ModuleHarness(Timed) as harness:
        harness.advance(0.65)
        timed = harness.module
        assert timed.times_ms("steer") == [0, 100, 200, 300, 400, 500, 600]
        assert timed.times_ms("slow") == [0, 300, 600]
        assert timed.times_ms("tick") == [0, 250, 500]
        assert [one.header.frame_id for one in harness.take(DriveCommand)] == ["base"] * 7


def test_handler_may_stop_a_timer_and_add_another_one() -> None:
    with ModuleHarness(Timed) as harness:
        harness.advance(0.15)
        harness.send(LaserScan())
        harness.advance(0.5)
        assert harness.module.times_ms("slow") == [0]
        assert harness.module.times_ms("later") == [150, 350, 550]


def test_module_with_timers_needs_no_period() -> None:
    class OnlyTimers(Timed):
        period_s = None  # type: ignore[assignment]

    with ModuleHarness(OnlyTimers) as harness:
        harness.advance(0.25)
        assert [what for _, what in harness.module.journal] == ["steer", "slow", "steer", "steer"]


def test_error_in_a_timer_ends_the_module() -> None:
    class Failing(Module):
        def setup(self) -> None:
            self.every(0.1, lambda: 1 / 0)

    with pytest.raises(ZeroDivisionError), ModuleHarness(Failing) as harness:
        harness.advance(0.0)


@pytest.mark.parametrize("period", [0, -1.0, math.inf, 1e300, math.nan, "0.1", True, None])
def test_period_must_be_a_positive_time(period: Any) -> None:
    with ModuleHarness(Timed) as harness, pytest.raises(InvalidTimer, match=r"give a time greater than 0"):
        harness.module.every(period, harness.module.steer)


def test_function_must_be_callable_without_arguments() -> None:
    with ModuleHarness(Timed) as harness:
        with pytest.raises(InvalidHandler, match=r"without parentheses"):
            harness.module.every(0.1, harness.module.steer())  # type: ignore[func-returns-value, arg-type]
        with pytest.raises(InvalidHandler, match=r"note is called with no argument"):
            harness.module.every(0.1, harness.module.note)  # type: ignore[arg-type]


class HeldClock(ManualClock):
    """The clock of a run that may stand still, and be set."""

    rate = 1.0

    def machine_s_until(self, monotonic_ns: int) -> float:
        return math.inf if self.rate == 0 else super().machine_s_until(monotonic_ns) / self.rate


class Machine:
    """The machine's clock, and what a run's timers see of a bus."""

    def __init__(self) -> None:
        self.clock = HeldClock()
        self.machine_ns = 0
        self.peers = self
        self.due = Due()
        self.timers = Timers(self, self.clock, self.due)  # type: ignore[arg-type]
        self.counted: list[tuple[int, int]] = []
        self.timers.count = lambda late_ns, _begun_ns, missed: self.counted.append((late_ns, missed))

    def now_ns(self) -> int:
        return self.machine_ns

    def pass_s(self, seconds: float) -> None:
        self.machine_ns += round(seconds * 1e9)
        self.clock.advance(seconds * self.clock.rate)
        while self.machine_ns >= self.due.ns:
            self.due.ns = NEVER_NS
            self.timers.run()


def test_late_calls_are_counted_and_missed_ones_skipped() -> None:
    machine = Machine()
    calls: list[int] = []
    machine.timers.add(0.1, lambda: calls.append(machine.clock.monotonic_ns()))
    machine.timers.begin()
    for seconds in (0.0, 0.1, 0.35, 0.05, 0.1):
        machine.pass_s(seconds)
    assert [round(ns / 1e6) for ns in calls] == [0, 100, 450, 450, 500, 600]
    assert [(round(late_ns / 1e6), missed) for late_ns, missed in machine.counted] == [
        (0, 0), (0, 0), (250, 1), (50, 0), (0, 0), (0, 0),
    ]  # fmt: skip


def test_timers_stand_still_with_the_clock_and_begin_again_when_it_is_set() -> None:
    machine = Machine()
    calls: list[int] = []
    machine.timers.add(0.1, lambda: calls.append(1))
    machine.timers.begin()
    machine.pass_s(0.0)
    machine.clock.rate = 0.0
    for _ in range(100):
        machine.pass_s(0.05)
    assert len(calls) == 1
    machine.clock.rate = 2.0
    for _ in range(3):
        machine.pass_s(0.02)
    assert len(calls) == 2, "seen within the time between two looks"
    machine.clock._now_ns = 0
    machine.clock.jumps = 1
    machine.pass_s(0.02)
    assert len(calls) == 3


@pytest.mark.parametrize(
    ("tick_ms", "periods_ms", "step_ms"),
    [(0, [100], 100), (250, [100, 300], 50), (0, [33, 100], 3.3), (20, [1000], 20), (0, [7, 7], 7)],
)
def test_lockstep_grants_steps_that_fit_all_periods(
    tick_ms: int, periods_ms: list[int], step_ms: float
) -> None:
    machine = Machine()
    for ms in periods_ms:
        machine.timers.add(ms / 1000, lambda: None)
    assert machine.timers.step_ns(tick_ms * 1_000_000) == step_ms * 1_000_000


def test_timers_cost_a_module_without_any_nothing() -> None:
    with ModuleHarness(Module) as harness:
        assert calls_of(harness.module).due.ns == NEVER_NS
