"""In a live run, a module notices that its input has stopped, whatever turns its loop and its clock."""

import os
import signal
from typing import Any

import pytest

from tests._support.robot import Robot, wait_until

MODULES = """
import math

from robbie_mp import MessageHandling, Module
from robbie_mp.messages import LaserScan
from zoo.modules import Journal


class Laser(Module):
    period_s = 0.02

    def tick(self):
        self.publish(LaserScan())


class Blinded(Module):
    # its sweeps become ill-formed when a file is there

    period_s = 0.02

    def tick(self):
        is_blind = (self.output_directory / "blind").exists()
        self.publish(LaserScan(angle_min=math.nan if is_blind else 0.0))


class Dying(Module):
    period_s = 0.02
    ticks = 0

    def tick(self):
        self.ticks += 1
        if self.ticks <= 50 or self.ticks > 100:
            self.publish(LaserScan())


class Driver(Journal):
    def setup(self):
        self.subscribe(
            LaserScan, self.on_scan, MessageHandling.KEEP_ONLY_NEWEST, deadline_s=0.3, on_late=self.on_late
        )

    def on_scan(self, _scan):
        pass

    def on_late(self):
        self.note(self.clock.monotonic_ns() // 1000000)
"""
PROFILE = """
modules:
  laser: {class: "lasers:Laser"}
  driver: {class: "lasers:Driver"}
"""
LOCKSTEP = """
modules:
  time:
    class: robbie_mp.logs.simulated_time:SimulatedTime
    settings: {start_s: 1000.0, duration_s: 3.0, rate: null}
    ends_run: true
  laser: {class: "lasers:Dying"}
  driver: {class: "lasers:Driver"}
clock: {source: time, lockstep: true}
"""


def subscription(figures: dict[str, dict[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = next(
        one for one in figures["driver"]["subscriptions"] if one["type_name"].endswith("LaserScan")
    )
    return found


@pytest.mark.slow
@pytest.mark.parametrize("pure_python", ["0", "1"])
def test_stopped_publisher_is_noticed_and_shown(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, pure_python: str
) -> None:
    monkeypatch.setenv("ROBBIE_PURE_PYTHON", pure_python)
    (robot.folder / "lasers.py").write_text(MODULES)
    robot.write_profile(PROFILE)
    robot.start()
    figures = robot.until(lambda top: top["driver"]["handled"] > 20 and not top["driver"]["health"])
    before = subscription(figures)
    assert before["deadline_s"] == 0.3
    laser = figures["laser"]["pid"]
    os.kill(laser, signal.SIGSTOP)
    try:
        figures = robot.until(lambda top: bool(top["driver"]["health"]))
        wait_until(lambda: len(robot.journal("driver")) > before["latenesses"])
        late = subscription(figures)
        assert figures["driver"]["health"].startswith("no LaserScan for 0.")
        assert late["latenesses"] == before["latenesses"] + 1
        assert 0.3 <= late["greatest_age_s"] <= late["age_s"]
        shown = robot.command("top", "--once", "--interval", "0").stdout
        assert "DEGRADED" in shown
        assert "no LaserScan for" in shown
    finally:
        os.kill(laser, signal.SIGCONT)
    robot.until(lambda top: not top["driver"]["health"])
    wait_until(lambda: "OK again: LaserScan comes again" in robot.log("driver"))
    assert "DEGRADED: no LaserScan for 0.3 s" in robot.log("driver")


@pytest.mark.slow
@pytest.mark.parametrize("pure_python", ["0", "1"])
def test_input_that_is_only_ill_formed_is_late(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, pure_python: str
) -> None:
    monkeypatch.setenv("ROBBIE_PURE_PYTHON", pure_python)
    (robot.folder / "lasers.py").write_text(MODULES)
    robot.write_profile(PROFILE.replace("lasers:Laser", "lasers:Blinded"))
    robot.start()
    robot.until(lambda top: top["driver"]["handled"] > 20 and not top["driver"]["health"])
    blind = robot.output / "blind"
    blind.touch()
    figures = robot.until(lambda top: top["driver"]["health"].startswith("no LaserScan for"))
    assert figures["driver"]["ill_formed"]
    assert subscription(figures)["latenesses"]
    blind.unlink()
    robot.until(lambda top: not top["driver"]["health"])


@pytest.mark.slow
def test_deadlines_pass_in_lockstep_by_the_steps_of_the_run(robot: Robot) -> None:
    (robot.folder / "lasers.py").write_text(MODULES)
    robot.write_profile(LOCKSTEP)
    assert robot.run().exit_code == 0
    (late_ms,) = robot.journal("driver")
    assert 1_001_270 <= late_ms <= 1_001_360, "0.3 s of the run after the last scan, to a tick of 0.05 s"
