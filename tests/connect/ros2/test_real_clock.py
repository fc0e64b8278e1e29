"""A run in the time of a real node of ROS 2, which sends /clock as simulators do; see `make ros`."""

import os
from pathlib import Path
from typing import Any

import pytest

from tests._support.robot import Robot, kill, wait_until
from tests.connect.ros2._support.ros_nodes import DISTRIBUTIONS, ros_node

pytestmark = pytest.mark.slow
DOMAIN = 30 + os.getpid() % 80
CLOCKWORK = """
from robbie_mp import Module, setting
from robbie_mp.messages import TimeJump

class Clockwork(Module):
    period_s = 0.05

    def setup(self):
        self.jumps = 0
        self.subscribe(TimeJump, self.on_jump, optional=True)

    def on_jump(self, jump):
        self.jumps += 1

    def tick(self):
        self.status = f"{self.clock.now_ns() / 1e9:.3f} {self.jumps}"
"""
PROFILE = """
modules:
  clockwork: {{class: "zoo.clockwork:Clockwork"}}
  ros:
    class: "robbie_mp.connect.ros2.module:Ros2Bridge"
    settings: {{middleware: dds, domain: {domain}, accept: {{/cmd_vel: Twist as DriveCommand}}}}
clock: {{follow: ros}}
"""
SIMULATE = """
import threading, time
from rosgraph_msgs.msg import Clock
from rclpy.qos import qos_profile_sensor_data
publisher = node.create_publisher(Clock, "/clock", qos_profile_sensor_data)
state = {"at": 100.0, "rate": 1.0, "on": True}
def simulate():
    begun = time.monotonic()
    while not state.get("end"):
        time.sleep(0.01)
        now = time.monotonic()
        state["at"] += (now - begun) * state["rate"]
        begun = now
        if state["on"]:
            message = Clock()
            message.clock.sec, message.clock.nanosec = int(state["at"]), int(state["at"] % 1 * 1e9)
            publisher.publish(message)
threading.Thread(target=simulate, daemon=True).start()
"""
NOW = "result = state['at']"


@pytest.mark.sampled(1)
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_modules_live_in_the_time_of_a_simulator(robot: Robot, tmp_path: Path, distribution: str) -> None:
    (robot.folder / "zoo" / "clockwork.py").write_text(CLOCKWORK)
    domain = DOMAIN + DISTRIBUTIONS.index(distribution)
    robot.write_profile(PROFILE.format(domain=domain))

    def shown() -> tuple[float, int]:
        """Return the time in which the module lives, and how often it was reset."""
        at_s, _, jumps = robot.top()["clockwork"]["status"].partition(" ")
        return float(at_s), int(jumps)

    def differs_by_s(**state: Any) -> float:
        """Set the simulator's state; return how far the module's time is from the simulator's."""
        now_s: float = node.run(f"state.update({state!r})\n" + NOW)
        return abs(shown()[0] - now_s)

    with ros_node(distribution, domain, tmp_path) as node:
        robot.start()
        robot.until(lambda figures: "waiting for ros" in figures["clockwork"]["status"])
        node.run(SIMULATE)
        robot.until(lambda figures: figures["clockwork"]["status"].startswith("1"))
        wait_until(lambda: differs_by_s() < 0.2, 20.0)
        begin_s = shown()[0]
        differs_by_s(rate=2.0)
        wait_until(lambda: shown()[0] > begin_s + 4.0, 20.0)
        wait_until(lambda: differs_by_s() < 0.3, 20.0)
        differs_by_s(rate=0.0)
        wait_until(lambda: differs_by_s() < 0.1, 20.0)
        assert "no message" not in str(robot.top()["ros"])
        differs_by_s(at=5.0, rate=1.0)
        wait_until(lambda: shown()[1] == 1 and differs_by_s() < 0.2, 20.0)
        differs_by_s(on=False)
        robot.until(lambda figures: "no message on /clock" in str(figures["ros"]))
        stands_s = shown()
        differs_by_s(on=True)
        wait_until(lambda: differs_by_s() < 0.2 and shown() > stands_s, 20.0)
        kill(robot.top()["ros"]["pid"])
        robot.until(lambda figures: figures["ros"]["restarts"] == 1 and figures["ros"]["state"] == "RUNNING")
        wait_until(lambda: differs_by_s() < 0.2, 20.0)
        assert robot.top()["clockwork"]["restarts"] == 0
