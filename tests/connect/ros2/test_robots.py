"""Whole robots and every stock type, over both middlewares."""

import hashlib
import json
import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from robbie_mp import ModuleHarness
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages import DriveCommand, Time, Twist, Vector3
from robbie_mp.messages.stock.registry import stock_registry
from tests._support.robot import Robot, kill, wait_until
from tests.connect.ros2.test_type_hash import PUBLISHED
from tests.connect.ros2.test_zenoh import ROS, TWIST, Node, free_port, session, zenoh_has_started

__all__ = ["zenoh_has_started"]
DOMAIN = 120 + os.getpid() % 80
JAZZY = get_typestore(Stores.ROS2_JAZZY)
RECEIVING = Path(__file__).with_name("receiving_bridge.py")
PROFILE = """
modules:
  counter: {{class: "zoo.modules:Counter", settings: {{count: 1000000}}}}
  listener: {{class: "zoo.modules:Listener"}}
  ros2:
    class: "robbie_mp.connect.ros2.module:Ros2Bridge"
    settings:
      domain: 7
      connect: ["tcp/127.0.0.1:{port}"]
      send: {{DriveCommand: /commands}}
      accept: {{/cmd_vel: Twist as DriveCommand ros}}
"""


@pytest.mark.slow
@pytest.mark.parametrize("middleware", ["zenoh", "dds"])
def test_every_stock_type_crosses_unchanged(middleware: str) -> None:
    stock = {f"t{number}": one for number, one in enumerate(stock_registry())}
    port = free_port()
    sending = {"send": {"*": "/all/{topic}"}, "connect": [], "listen": [f"tcp/127.0.0.1:{port}"]}
    accept = {f"/all/{topic}": f"{one.type_name} {topic}" for topic, one in stock.items()}
    receiving = {"accept": accept, "connect": [f"tcp/127.0.0.1:{port}"], "listen": []}
    both = {"middleware": middleware, "domain": DOMAIN}
    command = [sys.executable, str(RECEIVING), json.dumps({**both, **receiving}), str(len(stock))]
    with (
        ModuleHarness(Ros2Bridge, {**both, **sending}) as bridge,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other,
    ):

        def has_ended() -> bool:
            for topic, one in stock.items():
                bridge.send(one(), topic=topic)
            bridge.advance(0.02)
            return other.poll() is not None

        wait_until(has_ended, 60.0)
        found = json.loads(other.communicate()[0])
    assert found == {topic: hashlib.sha256(one().encode()).hexdigest() for topic, one in stock.items()}


@pytest.mark.slow
def test_a_killed_bridge_comes_back_and_the_robot_goes_on(robot: Robot) -> None:
    port = free_port()
    robot.write_profile(PROFILE.format(port=port))
    with ExitStack() as stack:
        stack.enter_context(session(mode="router", listen__endpoints=[f"tcp/127.0.0.1:{port}"]))
        node = Node(port, stack)
        got: list[object] = []
        key = f"7/commands/robbie_msgs::msg::dds_::DriveCommand_/{type_hash(DriveCommand)}"
        node.session.declare_subscriber(key, got.append)
        robot.start()
        twist = Twist(linear=Vector3(x=0.4)).encode()

        def drives() -> bool:
            node.publish(f"7/cmd_vel/{TWIST}", twist)
            figures = robot.top()
            return bool(figures and got and ", received 0" not in f", {figures['ros2']['status']}")

        wait_until(drives, 60.0)
        (killed,) = [one["pid"] for name, one in robot.top().items() if name == "ros2"]
        kill(killed)
        robot.until(lambda figures: figures["ros2"]["pid"] not in (0, killed))
        got.clear()
        wait_until(drives, 60.0)
        assert robot.top()["counter"]["restarts"] == 0
        assert robot.top()["listener"]["restarts"] == 0


@pytest.mark.slow
def test_time_of_a_simulation_reaches_ros(robot: Robot) -> None:
    port = free_port()
    time_module = (
        '  time: {class: "robbie_mp.logs.simulated_time:SimulatedTime", settings: {duration_s: 600}}\n'
    )
    lockstep = "clock: {source: time, lockstep: true}\n"
    robot.write_profile(PROFILE.format(port=port) + time_module + lockstep)
    with ExitStack() as stack:
        stack.enter_context(session(mode="router", listen__endpoints=[f"tcp/127.0.0.1:{port}"]))
        node = Node(port, stack)
        got: list[bytes] = []
        key = f"7/clock/rosgraph_msgs::msg::dds_::Clock_/{PUBLISHED['rosgraph_msgs/msg/Clock']}"
        node.session.declare_subscriber(key, lambda sample: got.append(sample.payload.to_bytes()))
        robot.start()
        wait_until(lambda: len(got) > 20, 60.0)
        times = [Time.decode(one).nanoseconds for one in got]
        assert times == sorted(times)
        assert times[0] < times[-1]


@pytest.mark.slow
def test_ros_hears_of_a_killed_module(robot: Robot) -> None:
    port = free_port()
    robot.write_profile(PROFILE.format(port=port))
    with ExitStack() as stack:
        stack.enter_context(session(mode="router", listen__endpoints=[f"tcp/127.0.0.1:{port}"]))
        node = Node(port, stack)
        heard: dict[str, list[Any]] = {
            "rcl_interfaces/msg/Log": [],
            "diagnostic_msgs/msg/DiagnosticArray": [],
        }
        for name, found in heard.items():
            topic = "rosout" if name.endswith("Log") else "diagnostics"
            package, _, short = name.split("/")
            key = f"7/{topic}/{package}::msg::dds_::{short}_/{PUBLISHED[name]}"
            node.session.declare_subscriber(
                key,
                lambda sample, name=name, found=found: found.append(
                    ROS.deserialize_cdr(sample.payload.to_bytes(), name)
                ),
            )
        lines, arrays = heard.values()
        robot.start()
        wait_until(lambda: bool(arrays), 30.0)
        kill(robot.top()["listener"]["pid"])

        def has_been_heard() -> bool:
            statuses = [one for array in arrays for one in array.status if one.name == "robbie: listener"]
            is_diagnosed = any("restarted" in one.message for one in statuses)
            return is_diagnosed and any(one.level == 40 and "listener" in one.name for one in lines)

        wait_until(has_been_heard, 30.0)
