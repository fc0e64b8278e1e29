"""A robot with a latched map: a module that starts late has it, whatever was killed before."""

import json
import os
import signal
from contextlib import closing
from typing import Any

import pytest

from robbie_mp.bus.observe.unhandled import UnhandledMessages
from tests._support.robot import Robot, wait_until

MODULES = '''
import numpy as np

from robbie_mp import Module, setting
from robbie_mp.messages import Image, Message, int64


class Beacon(Message, name="zoo_msgs/msg/Beacon", version=1, latched=True):
    number: int64


class Mapper(Module):
    """Publishes maps, each larger than half of its memory, and says how many there were."""

    period_s = 0.1
    count: int = setting(5, "maps to publish")

    def setup(self):
        self.done = (self.restored or 0)
        self.data = np.zeros(40_000_000, np.uint8)

    def tick(self):
        if self.done < self.count:
            number = self.done + 1
            # On a busy machine, a reader may hold an older map for longer than a publisher waits for room.
            if self.publish(Image(height=number, data=self.data), topic="map", latched=True):
                self.done = number
                self.checkpoint(self.done)
                self.publish(Beacon(number=number))
        self.status = f"{self.done} maps"


class Reader(Module):
    """Says which map and which beacon it has got first, and last."""

    def setup(self):
        self.maps, self.beacons = [], []
        self.subscribe(Image, self.on_map, topic="map")
        self.subscribe(Beacon, self.on_beacon)

    def on_map(self, image):
        self.maps.append(image.height)
        self.show()

    def on_beacon(self, beacon):
        self.beacons.append(beacon.number)
        self.show()

    def show(self):
        self.status = f"{self.maps[:1]} {self.beacons[:1]}"
'''
PROFILE = """
modules:
  mapper:
    class: "zoo.maps:Mapper"
    memory: {limit_bytes: 64000000}
    restart: {policy: never}
  reader: {class: "zoo.maps:Reader"}
"""


@pytest.mark.slow
def test_late_module_has_the_newest_map_though_publisher_and_core_were_killed(robot: Robot) -> None:
    (robot.folder / "zoo" / "maps.py").write_text(MODULES)
    robot.write_profile(PROFILE)
    robot.start()
    # Each map has only room if an older one gives way.
    figures = robot.until(lambda modules: modules["mapper"]["status"] == "5 maps")
    with closing(UnhandledMessages(robot.known_run().run_id, "mapper")) as unhandled:
        wait_until(lambda: unhandled.count() == 0)  # what the core keeps for later is not unhandled
    os.kill(figures["mapper"]["pid"], signal.SIGKILL)
    robot.until(lambda modules: modules["mapper"]["state"] == "FAILED")
    os.kill(figures["core"]["pid"], signal.SIGKILL)
    robot.until(lambda modules: modules["core"]["restarts"] == 1 and modules["core"]["state"] == "RUNNING")
    echo = robot.command("echo", "Beacon", "--once")
    assert "number: 5" in echo.stdout, echo.stderr
    assert robot.command("pub", "Vector3", "{x: 7}", "--topic", "by_hand", "--latched").returncode == 0
    assert "x: 7" in robot.command("echo", "Vector3", "--topic", "by_hand", "--once").stdout
    topics = {topic["topic"]: topic for topic in json.loads(robot.command("list", "topics", "--json").stdout)}
    assert topics["map"]["latched"] and 40_000_000 < topics["map"]["latched_bytes"] < 41_000_000
    assert topics["by_hand"]["latched"] and 0 < topics["by_hand"]["latched_bytes"] < 100
    for restarts in (1, 2):
        figures = until(robot, restarts - 1)
        os.kill(figures["reader"]["pid"], signal.SIGKILL)
        figures = until(robot, restarts, "[5] [5]")
    assert figures["core"]["waiting"] == 3
    assert figures["core"]["waiting_bytes"] > 40_000_000


def until(robot: Robot, restarts: int, status: str = "") -> dict[str, dict[str, Any]]:
    """Wait until the reader runs again, and shows a status."""

    def is_back(modules: dict[str, dict[str, Any]]) -> bool:
        reader = modules["reader"]
        return (reader["state"], reader["restarts"]) == ("RUNNING", restarts) and status in reader["status"]

    return robot.until(is_back)


DEADLY = '''
import os

from robbie_mp import Module
from robbie_mp.messages import Vector3


class Pilot(Module):
    """Dies over what has x = 13."""

    def setup(self):
        self.subscribe(Vector3, self.on_vector, topic="goal", optional=True)

    def on_vector(self, vector):
        if vector.x == 13:
            os.kill(os.getpid(), 9)
        self.status = f"flies to {vector.x}"
'''
DEADLY_PROFILE = """
modules:
  pilot: {class: "zoo.pilots:Pilot"}
  other: {class: "zoo.modules:Idle"}
"""


@pytest.mark.slow
def test_latched_message_that_kills_its_handler_is_not_given_a_third_time(robot: Robot) -> None:
    (robot.folder / "zoo" / "pilots.py").write_text(DEADLY)
    robot.write_profile(DEADLY_PROFILE)
    robot.start()
    robot.until(lambda modules: modules["other"]["state"] == "RUNNING")
    assert robot.command("pub", "Vector3", "{x: 13}", "--topic", "goal", "--latched").returncode == 0
    robot.until(lambda modules: (modules["pilot"]["state"], modules["pilot"]["restarts"]) == ("RUNNING", 2))
    wait_until(lambda: "no longer gets latched message" in robot.log("core"))
    figures = robot.top()["pilot"]
    assert figures["subscriptions"][0]["withheld"] == 1
    reason = "no longer gets the latched geometry_msgs/Vector3 on topic 'goal': died over it twice"
    assert figures["health"] == reason
    shown = robot.command("top", "--once", "--interval", "0").stdout
    assert "DEGRADED" in shown
    assert "no longer gets" in shown
    assert "x: 13" in robot.command("echo", "Vector3", "--topic", "goal", "--once").stdout, "others do"
    (robot.folder / "zoo" / "pilots.py").write_text(DEADLY.replace("13", "14"))
    assert robot.command("module", "restart", "pilot").returncode == 0
    figures = robot.until(lambda modules: modules["pilot"]["status"] == "flies to 13.0")
    assert robot.command("pub", "Vector3", "{x: 7}", "--topic", "goal", "--latched").returncode == 0
    figures = robot.until(lambda modules: modules["pilot"]["status"] == "flies to 7.0")
    assert figures["pilot"]["restarts"] == 3
    assert figures["pilot"]["health"] == ""
