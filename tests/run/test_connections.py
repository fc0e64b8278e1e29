"""A run says which subscriptions nobody publishes for, and for whom a start waits."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from robbie_mp.bus.observe.connections import Unconnected
from robbie_mp.run.supervisor.connection_watch import CHECK_PERIOD_S, ConnectionWatch
from robbie_mp.run.trace.kinds import Kind
from tests._support.robot import Ended, Robot, wait_until

LOST = Unconnected("a/msg/B", 1, "scan", "nobody publishes it")
MODULES = """
from robbie_mp import Module
from robbie_mp.messages import BatteryState, DriveCommand, LaserScan, Odometry


class Laser(Module):
    period_s = 0.05

    def setup(self):
        self.advertise(BatteryState, topic="rare")

    def tick(self):
        self.publish(LaserScan(), topic="front")


class Mapping(Module):
    def setup(self):
        self.subscribe(LaserScan, print, topic="scan")
        self.subscribe(LaserScan, self.ignore, topic="front")
        self.subscribe(BatteryState, self.ignore, topic="rare")
        self.subscribe(DriveCommand, self.ignore, topic="operator", optional=True)
        self.subscribe(Odometry, self.ignore)
        self.subscribe_encoded("nothing/*", self.ignore)

    def ignore(self, _message):
        pass


class Slow(Module):
    def setup(self):
        import time
        time.sleep(30)
"""


def watch(found: Callable[[], dict[str, Any]], now_s: Callable[[], float]) -> tuple[Any, list[str]]:
    said: list[str] = []
    observer: Any = SimpleNamespace(unconnected=found)
    return ConnectionWatch(observer, lambda kind, text: said.append(f"{kind}: {text}"), clock=now_s), said


def test_unconnected_subscription_is_said_once_and_only_when_found_twice() -> None:
    found: dict[str, Any] = {"mapping": (LOST,)}
    now_s = [0.0]
    looking, said = watch(lambda: found, lambda: now_s[0])
    looking.turn()
    looking.turn()
    assert not said, "twice means at two times"
    for _ in range(4):
        now_s[0] += CHECK_PERIOD_S
        looking.turn()
    assert said == [f"{Kind.WARNING}: mapping gets no a/B on topic 'scan': nobody publishes it"]


def test_subscription_that_is_soon_connected_is_not_mentioned() -> None:
    found: dict[str, Any] = {"mapping": (LOST,)}
    now_s = [0.0]
    looking, said = watch(lambda: found, lambda: now_s[0])
    looking.turn()
    found.clear()
    now_s[0] += CHECK_PERIOD_S
    looking.turn()
    assert not said


@pytest.mark.slow
def test_run_top_and_doctor_warn_of_what_nobody_publishes(robot: Robot) -> None:
    (robot.folder / "zoo" / "wired.py").write_text(MODULES)
    robot.write_profile("modules: {laser: {class: 'zoo.wired:Laser'}, mapping: {class: 'zoo.wired:Mapping'}}")
    process = robot.start()
    figures = robot.until(lambda modules: bool(modules["mapping"]["unconnected"]))
    expected = [
        "gets no sensor_msgs/LaserScan on topic 'scan': it is published only on topic 'front' (by laser)",
        "gets no nav_msgs/Odometry: nobody publishes it",
    ]
    assert [str(Unconnected(**one)) for one in figures["mapping"]["unconnected"]] == expected
    assert not figures["laser"]["unconnected"]
    wait_until(lambda: "Odometry: nobody" in robot.log("supervisor"), 10)
    shown = robot.command("top", "--once", "--interval", "0")
    assert "2 UNCONNECTED" in shown.stdout
    assert "gets no sensor_msgs/LaserScan" in robot.command("doctor").stdout.replace("\n", " ")
    process.send_signal(2)
    Ended.wait_for(process)
    warned = [line for line in robot.log("supervisor").splitlines() if "gets no" in line]
    assert warned == [f"mapping {one}" for one in expected]


@pytest.mark.slow
def test_start_that_waits_says_for_whom(robot: Robot) -> None:
    (robot.folder / "zoo" / "wired.py").write_text(MODULES)
    robot.write_profile("modules: {laser: {class: 'zoo.wired:Laser'}, slow: {class: 'zoo.wired:Slow'}}")
    process = robot.start()
    wait_until(lambda: "the start still waits for slow (STARTING)" in robot.log("supervisor"), 30)
    assert "the start waits for slow" in robot.command("top", "--once", "--interval", "0").stdout
    process.send_signal(2)
    process.send_signal(2)
    Ended.wait_for(process)
