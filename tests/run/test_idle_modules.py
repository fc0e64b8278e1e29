"""A module that nothing will ever call says so once."""

import pytest

from tests._support.robot import Robot

pytestmark = pytest.mark.slow

MODULES = """
import threading
from robbie_mp import Module, setting
from robbie_mp.messages import LaserScan


class Idle(Module):
    gain: float = setting(1.0, "a setting that may change", changeable=True)

    def on_scan(self, scan: LaserScan) -> None: ...


class Hears(Module):
    def setup(self):
        self.subscribe(LaserScan, print)


class Threaded(Module):
    def setup(self):
        self.done = threading.Event()
        threading.Thread(target=self.done.wait).start()

    def teardown(self):
        self.done.set()


class Ends(Module):
    def setup(self):
        self.every(0.2, self.stop)
"""
PROFILE = """
modules:
  idle: {class: "idle:Idle"}
  hears: {class: "idle:Hears"}
  threaded: {class: "idle:Threaded"}
  ends: {class: "idle:Ends", ends_run: true}
"""


def test_module_without_anything_that_calls_it_says_so_once(robot: Robot) -> None:
    (robot.folder / "idle.py").write_text(MODULES)
    robot.write_profile(PROFILE)
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr
    assert robot.log("idle").count("Idle does nothing: it has no subscription, service, timer") == 1
    assert not any("does nothing" in robot.log(name) for name in ("hears", "threaded", "ends"))
