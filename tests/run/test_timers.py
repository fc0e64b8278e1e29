"""Timers of a module in a real run: by either form of the loop, in lockstep, and after a restart."""

from itertools import pairwise

import pytest

from tests._support.robot import Robot, kill, wait_until

pytestmark = pytest.mark.slow

MODULES = """
from robbie_mp import setting
from zoo.modules import Journal


class Timed(Journal):
    period_s: float = setting(0.2, "between ticks")

    def setup(self):
        self.every(0.05, lambda: self.write_down("fast"))
        self.every(0.3, lambda: self.write_down("slow"))

    def tick(self):
        self.write_down("tick")

    def write_down(self, what):
        self.note(10 * round(self.clock.now_ns() / 1e6) + ("fast", "slow", "tick").index(what))
"""
PROFILE = 'modules: {timed: {class: "timed:Timed"}}'
LOCKSTEP = """
modules:
  time:
    class: robbie_mp.logs.simulated_time:SimulatedTime
    settings: {start_s: 1000.0, duration_s: 1.0, rate: null}
    ends_run: true
  timed: {class: "timed:Timed"}
clock: {source: time, lockstep: true}
"""


def calls_ms(robot: Robot, what: str) -> list[int]:
    number = ("fast", "slow", "tick").index(what)
    return [entry // 10 for entry in robot.journal("timed") if entry % 10 == number]


@pytest.mark.parametrize("pure_python", ["0", "1"])
def test_timers_run_in_a_process_and_again_after_a_restart(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, pure_python: str
) -> None:
    monkeypatch.setenv("ROBBIE_PURE_PYTHON", pure_python)
    (robot.folder / "timed.py").write_text(MODULES)
    robot.write_profile(PROFILE)
    robot.start()
    wait_until(lambda: len(calls_ms(robot, "slow")) > 3)
    fast, slow, ticks = (len(calls_ms(robot, what)) for what in ("fast", "slow", "tick"))
    assert fast > 3 * slow and slow < ticks < fast
    figures = robot.until(lambda top: top["timed"]["ticks"] > 20)
    assert figures["timed"]["ticks"] <= sum(len(calls_ms(robot, what)) for what in ("fast", "slow", "tick"))
    kill(figures["timed"]["pid"])
    robot.until(lambda top: top["timed"]["restarts"] == 1 and top["timed"]["ticks"] > 5)


def test_timers_pass_in_lockstep_exactly_in_their_periods(robot: Robot) -> None:
    (robot.folder / "timed.py").write_text(MODULES)
    robot.write_profile(LOCKSTEP)
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr
    for what, period_ms in (("fast", 50), ("slow", 300), ("tick", 200)):
        times = calls_ms(robot, what)
        assert times[0] == 1_000_000
        assert {after - before for before, after in pairwise(times)} == {period_ms}
