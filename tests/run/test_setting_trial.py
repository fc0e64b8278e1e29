"""A value set with `robbie param set` that kills its module is taken back, and can be changed again."""

import pytest

from tests._support.robot import Robot

MODULES = """
import os

from robbie_mp import Module, setting


class Touchy(Module):
    period_s = 0.02
    gain: int = setting(1, "how much", changeable=True)

    def setup(self):
        if self.gain == 0:
            raise ValueError("a gain of 0 does nothing")

    def tick(self):
        if self.gain == 13:
            os.kill(os.getpid(), 9)
        self.status = f"gain {self.gain}"
"""
PROFILE = """
modules:
  touchy: {class: "touchy:Touchy", settings: {gain: 2}}
  broken: {class: "touchy:Touchy", settings: {gain: 0}, restart: {policy: never}}
"""


@pytest.mark.slow
def test_value_that_kills_its_module_is_taken_back_and_one_that_cures_it_is_taken_at_its_start(
    robot: Robot,
) -> None:
    (robot.folder / "touchy.py").write_text(MODULES)
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda top: top["touchy"]["status"] == "gain 2" and top["broken"]["state"] == "FAILED")

    assert robot.command("param", "set", "touchy.gain", "13").returncode == 0
    figures = robot.until(lambda top: top["touchy"]["restarts"] == 1 and top["touchy"]["status"] == "gain 2")
    assert figures["touchy"]["health"].startswith("setting gain was taken back from 13 to 2")
    assert "was taken back from 13 to 2" in robot.log("touchy")
    answer = robot.command("param", "set", "touchy.gain", "7")
    assert answer.stdout == "touchy.gain is 7, was 2\n", answer.stderr
    robot.until(lambda top: top["touchy"]["status"] == "gain 7" and not top["touchy"]["health"])

    answer = robot.command("param", "set", "broken.gain", "5")
    assert answer.stdout == "broken is FAILED: it takes broken.gain = 5 at its next start\n", answer.stderr
    assert robot.command("module", "start", "broken").returncode == 0
    figures = robot.until(lambda top: top["broken"]["status"] == "gain 5")
    assert figures["touchy"]["restarts"] == 1
