"""Logs beside real nodes of ROS 2: one that is played into ROS, and one of what ROS asks of the robot."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from robbie_mp.logs.recording.format import LATCHED_KEY
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import MapMetaData, OccupancyGrid, schema_text
from tests._support.robot import Robot, wait_until
from tests.connect.ros2._support import fibonacci
from tests.connect.ros2._support.ros_nodes import DISTRIBUTIONS, ros_node
from tests.logs.recording._support.logs import START_NS, STEP_NS, LogFile, scan

pytestmark = pytest.mark.slow
DOMAIN = 60 + os.getpid() % 80
PLAYED = """
parents: [robbie:playback]
modules:
  ros2:
    class: "robbie_mp.connect.ros2.module:Ros2Bridge"
    settings:
      middleware: dds
      domain: {domain}
      send:
        LaserScan laser/front: /scan best_effort depth=5
        OccupancyGrid map: /map
"""
HEAR = """
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
def stamp(message):
    return message.sec + message.nanosec * 1e-9
def hear(kind, name, quality, value):
    node.create_subscription(kind, name, lambda message: got[name].append(value(message)), quality)
hear(OccupancyGrid, "/map", latched, lambda grid: list(grid.data))
hear(LaserScan, "/scan", qos_profile_sensor_data, lambda scan: [stamp(scan.header.stamp), scan.ranges[0]])
hear(Clock, "/clock", 10, lambda clock: stamp(clock.clock))
node.create_subscription(LaserScan, "/scan", lambda _: got["strict"].append(1), 10)
"""
RECORDED = """
modules:
  logger: {{class: "robbie_mp.logs.message_logger:MessageLogger", settings: {{folder: logs}}}}
  rabbits: {{class: "zoo.fibonacci:Rabbits"}}
  ros2:
    class: "robbie_mp.connect.ros2.module:Ros2Bridge"
    settings:
      middleware: dds
      domain: {domain}
      actions: {{/fibonacci: Fibonacci}}
      calls: {{/save: Trigger}}
      send: {{ModuleState: /state}}
"""
SAVE = """

from robbie_mp import Reply, Request

class Saved(Reply, name="std_srvs/srv/Trigger_Response"):
    success: bool
    message: str

class SaveMap(Request[Saved], name="std_srvs/srv/Trigger_Request"):
    pass
"""
SERVE_AND_SEND = """
from rclpy.action import ActionClient
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci
def save(request, response):
    response.success, response.message = True, "saved"
    return response
serving = node.create_service(Trigger, "/save", save)
client = ActionClient(node, Fibonacci, "/fibonacci")
assert client.wait_for_server(20.0)
ends = []
def on_answer(future):
    future.result().get_result_async().add_done_callback(lambda end: ends.append(end.result().status))
client.send_goal_async(Fibonacci.Goal(order=5)).add_done_callback(on_answer)
"""


def write_log(path: Path) -> None:
    """Write a log of 20 s, with a map that was published only once."""
    grid = OccupancyGrid(info=MapMetaData(width=1, height=1, resolution=0.1), data=np.array([7], np.int8))
    with LogFile(path) as log:
        schema = log.writer.register_schema(grid.type_name, "ros2msg", schema_text(OccupancyGrid).encode())
        about = {"robbie_topic": "map", "robbie_version": "1", "robbie_sender": "mapping", LATCHED_KEY: "1"}
        log.add_bytes(log.writer.register_channel("/map", "cdr", schema, about), grid.encode(), START_NS)
        for number in range(200):
            time_ns = START_NS + number * STEP_NS
            log.add(scan(number, time_ns), "laser/front", "laser", time_ns=time_ns)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_log_is_played_into_ros_with_its_time_qualities_and_latched_topics(
    robot: Robot, tmp_path: Path, distribution: str
) -> None:
    domain = DOMAIN + DISTRIBUTIONS.index(distribution)
    write_log(tmp_path / "log.mcap")
    robot.write_profile(PLAYED.format(domain=domain))
    with ros_node(distribution, domain, tmp_path) as node:
        robot.start("--loop", command=("play", str(tmp_path / "log.mcap")))
        robot.until(lambda figures: figures.get("playback", {}).get("published", 0) > 5)
        node.run(HEAR)  # long after the map was played
        heard: dict[str, Any] = {}

        def is_all_heard() -> bool:
            heard.update(node.run("result = got"))
            return bool(heard.get("/map") and heard.get("/clock") and len(heard.get("/scan", ())) > 3)

        wait_until(is_all_heard, 30.0)
        assert heard["/map"][0] == [7]
        assert "strict" not in heard  # it needs reliable scans
        begin_s = START_NS * 1e-9
        assert all(begin_s - 1.0 <= one <= begin_s + 21.0 for one in heard["/clock"])
        for stamp_s, number in heard["/scan"]:
            assert stamp_s == pytest.approx(begin_s + number * STEP_NS * 1e-9, abs=1e-3)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_calls_and_goals_from_and_to_ros_are_recorded(
    robot: Robot, tmp_path: Path, distribution: str
) -> None:
    domain = DOMAIN + DISTRIBUTIONS.index(distribution)
    text = Path(fibonacci.__file__).read_text() + SAVE
    (robot.folder / "zoo" / "fibonacci.py").write_text(text)
    robot.write_profile(RECORDED.format(domain=domain))
    with ros_node(distribution, domain, tmp_path) as node:
        run = robot.start()
        robot.until(lambda figures: all(one["state"] == "RUNNING" for one in figures.values()))
        node.run(SERVE_AND_SEND)
        wait_until(lambda: node.run("result = ends") == [4], 30.0)
        wait_until(lambda: "saved" in robot.command("call", "Trigger").stdout, 60.0)
        run.terminate()
        assert run.wait(60) in (0, 130, 143)
    (log_path,) = (robot.folder / "logs").iterdir()
    with open_log(log_path) as log:
        kinds = {message.channel.type_name for message in log.messages()}
    action, service = "test_msgs/action/Fibonacci", "std_srvs/srv/Trigger"
    assert {f"{action}_Goal", f"{action}_Feedback", f"{action}_Result"} <= kinds
    assert {f"{service}_Request", f"{service}_Response"} <= kinds
    exported = robot.command("export", str(log_path), "bag", "--rosbag2")
    assert exported.returncode == 1  # something was left out
    assert f"messages of type {action}_Goal" in exported.stdout + exported.stderr
    with AnyReader([robot.folder / "bag"]) as reader:
        assert "/state" in {one.topic for one in reader.connections}
