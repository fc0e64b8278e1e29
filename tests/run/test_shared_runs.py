"""Two runs in lockstep share one simulated time, and one goes on when the other is killed."""

import subprocess
from pathlib import Path

import pytest

from tests._support.robot import Ended, Robot, kill, wait_until

pytestmark = pytest.mark.slow

PROFILE = """
modules:
  time:
    class: robbie_mp.logs.simulated_time:SimulatedTime
    settings: {{start_s: 1000.0, duration_s: {duration_s}, shared: {shared}, waits_for: 2, gives_up_s: 3.0}}
    ends_run: true
  chronicle: {{class: "zoo.modules:Chronicle"}}
  ticker: {{class: "zoo.modules:Ticker", settings: {{period_s: {period_s}}}}}
clock: {{source: time, lockstep: true}}
core: {{deadline_s: 60.0}}
"""
PERIODS_S = {"red": 0.05, "blue": 0.1}
TOGETHER_S = 0.12
"""A step of the slower one, and the 10 ms that one may be ahead."""
KILLED_S, END_S = 3.0, 8.0


def start(robot: Robot, name: str, duration_s: float) -> "subprocess.Popen[str]":
    shared = robot.folder / "shared"
    profile = PROFILE.format(duration_s=duration_s, shared=shared, period_s=PERIODS_S[name])
    robot.write_profile(profile, name=name)
    return robot.start("--another", profile=name, output=robot.folder / name)


def newest_s(folder: Path) -> float:
    """The simulated time of the newest line that a run has written, from its beginning."""
    file = folder / "chronicle.txt"
    lines = file.read_text().split("\n")[:-1] if file.exists() else []
    return int(lines[-1].split()[0]) / 1e9 - 1000.0 if lines else 0.0


def test_runs_stay_together_and_one_goes_on_when_the_other_is_killed(robot: Robot) -> None:
    red, blue = (robot.folder / name for name in PERIODS_S)
    robot.output = red
    first = start(robot, "red", END_S)
    second = start(robot, "blue", 1000.0)

    def is_time_to_kill() -> bool:
        before_s, other_s, after_s = newest_s(red), newest_s(blue), newest_s(red)
        assert before_s - TOGETHER_S <= other_s <= after_s + TOGETHER_S
        return other_s >= KILLED_S

    wait_until(is_time_to_kill)
    kill(second.pid)
    ended = Ended.wait_for(first)
    assert ended.exit_code == 0, ended.stderr
    assert newest_s(red) > END_S - TOGETHER_S
    assert newest_s(blue) < END_S - 1.0
    assert robot.log("time").count("time goes on without it") == 1
    assert "without 1 dead runs" in ended.modules["time"]["status"]
    assert robot.command("clean").returncode == 0
