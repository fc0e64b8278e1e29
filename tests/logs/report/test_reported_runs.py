"""The report of one real run: while it runs, after its supervisor was killed, and after it has been swept."""

import re
from pathlib import Path

import pytest

from tests._support.robot import Robot, robot_in, wait_until
from tests.logs.report.test_report import words

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
MODULES = """
from robbie_mp import Module
from robbie_mp.messages import Mark, String


class Source(Module):
    period_s = 0.02

    def tick(self):
        self.publish(String(data="<b>"))


class Victim(Module):
    def setup(self):
        self.subscribe(String, lambda said: None)
        self.subscribe(Mark, self.on_mark)

    def on_mark(self, mark):
        if mark.text == "crash":
            raise RuntimeError("as told <b>")
"""
PROFILE = """
modules:
  source: {class: "acts:Source"}
  victim: {class: "acts:Victim", restart: {backoff_s: 0.01, max_restarts: 1000}}
black_box: {before_s: 3, after_s: 1}
"""


def report_of(robot: Robot, name: str) -> str:
    path = robot.folder / name
    ended = robot.command("report", str(robot.output), "--output", str(path))
    assert ended.returncode == 0, ended.stderr
    return words(path.read_text())


def test_report_of_a_run_that_crashes_and_is_then_killed(tmp_path: Path) -> None:
    with robot_in(tmp_path) as robot:
        (robot.folder / "acts.py").write_text(MODULES)
        robot.write_profile(PROFILE, has_black_box=True)
        process = robot.start()
        robot.until(lambda top: top["victim"]["handled"] > 50)
        assert robot.command("mark", "crash").returncode == 0
        robot.until(lambda top: top["victim"]["restarts"] == 1 and top["victim"]["state"] == "RUNNING")
        wait_until(lambda: "1 failures, 1 recovered from" in report_of(robot, "live.html"))
        live = report_of(robot, "live.html")
        assert "still running" in live and "RuntimeError: as told &lt;b&gt;" in live
        process.kill()
        process.wait()
        killed = report_of(robot, "killed.html")
        assert "was killed" in killed
        assert re.search(r"Every message is accounted for: \d+ = ", killed)
        assert robot.command("clean").returncode == 0
        swept = report_of(robot, "swept.html")
        assert "The figures of its modules are lost" in swept
        assert "the supervisor was killed" in swept  # the clip that was written of what was left
