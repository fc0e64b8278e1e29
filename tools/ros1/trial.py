"""Kills roscore, the bridge and its ROS node at random, and looks whether the robot notices."""

import random
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import psutil
import yaml

from robbie_mp.connect.ros1 import ros_node
from robbie_mp.connect.ros1.definitions import ros1_name
from tools.journal import read_journal
from tools.robot import Robot
from tools.ros1.ros import Ros
from tools.ros1.stock import TYPES_OF_ROS1, topic_of

MODULES = "tools.ros1.modules:"
MAX_RETURN_S = 5.0
VICTIMS = ("roscore", "bridge", "ROS node")
SCAN = {"/scan": "sensor_msgs/LaserScan"}
ALL = {f"/{topic_of(one)}": ros1_name(one.type_name) for one in TYPES_OF_ROS1}


@dataclass
class Ros1Figures:
    """The result of a trial.

    Attributes:
        kills: how often each victim was killed.
        returned_s: after each kill, the time until a new ROS node had a message of the robot (s); counted
            from the return of roscore, or from the death of what else was killed.
        scans: scans that the robot published, and those that arrived inside it.
        longest_pause_s: the longest time between two scans.
        failures: what was not as promised.
    """

    kills: dict[str, int] = field(default_factory=lambda: dict.fromkeys(VICTIMS, 0))
    returned_s: list[float] = field(default_factory=list)
    scans: tuple[int, int] = (0, 0)
    longest_pause_s: float = 0.0
    failures: list[str] = field(default_factory=list)


@contextmanager
def robot_beside(ros: Ros, folder: Path) -> Iterator[Robot]:
    """A robot whose bridge looks for a ROS master; it starts without one."""
    bridge = {
        "master": ros.uri,
        "send": {"LaserScan scan": "/scan", "OccupancyGrid map": "/map latched", "* all/*": "/{topic}"},
        "accept": {
            "/cmd_vel": "Twist as DriveCommand manual",
            "/move_base_simple/goal": "PoseStamped as NavigateTo",
            "/initialpose": "PoseWithCovarianceStamped as PoseStamped initial_pose",
            "/move_base/status": "actionlib_msgs/* status",
        },
    }
    restart = {"policy": "always", "max_restarts": 1_000_000, "backoff_s": 0.05, "backoff_cap_s": 0.1}
    modules = {name.lower(): {"class": f"{MODULES}{name}"} for name in ("Listener", "Base", "Speaker")}
    ros1 = {"class": "robbie_mp.connect.ros1.module:Ros1Bridge", "settings": bridge, "restart": restart}
    (folder / "profiles").mkdir()
    text = yaml.safe_dump({"modules": {**modules, "ros1": ros1}}, sort_keys=False)
    (folder / "profiles" / "robot.yaml").write_text(text)
    with closing(Robot(folder / "run", folder, "robot")) as robot:
        robot.wait_until_running()
        try:
            yield robot
        finally:
            if robot.is_up:
                robot.stop()


def node_of(robot: Robot) -> psutil.Process | None:
    """Return the process of the bridge's ROS node; None if there is none at the moment."""
    try:
        children = psutil.Process(robot.figures()["ros1"].pid).children()
        return next((one for one in children if ros_node.__file__ in one.cmdline()), None)
    except psutil.NoSuchProcess:
        return None


def run_trial(ros: Ros, robot: Robot, kills: int, seed: int, pause_s: float = 1.0) -> Ros1Figures:
    """Kill, and wait until a new ROS node hears the robot again.

    Args:
        ros: a ROS that runs.
        robot: the robot beside it.
        kills: how often.
        seed: decides who is killed, and when.
        pause_s: the longest time before a kill, and before roscore is started again (s).
    """
    chance, figures = random.Random(seed), Ros1Figures()
    for number in range(kills):
        victim = VICTIMS[number % 3] if number < 3 else chance.choice(VICTIMS)
        time.sleep(chance.uniform(0.0, pause_s))
        figures.kills[victim] += 1
        began_s = _kill(ros, robot, victim, chance.uniform(0.0, pause_s))
        with ros.witness(f"witness{number}", SCAN) as witness:
            if not witness.read(1, limit_s=30.0):
                figures.failures.append(f"no topic came back after the death of the {victim}")
        figures.returned_s.append(time.monotonic() - began_s)
        if figures.returned_s[-1] > MAX_RETURN_S:
            figures.failures.append(f"topics came back {figures.returned_s[-1]:.1f} s after {victim}")
    _judge(robot, figures)
    return figures


def _kill(ros: Ros, robot: Robot, victim: str, away_s: float) -> float:
    """Kill something; return the time (s) from which the return of topics counts."""
    if victim == "roscore":
        ros.kill()
        time.sleep(away_s)
        return ros.start()
    process = psutil.Process(robot.figures()["ros1"].pid) if victim == "bridge" else node_of(robot)
    if process is not None:
        process.kill()
    return time.monotonic()


def _judge(robot: Robot, figures: Ros1Figures) -> None:
    for name, one in robot.figures().items():
        if name != "ros1" and one.restarts:
            figures.failures.append(f"{name} was restarted {one.restarts} times")
    heard = [int(line[1]) for line in read_journal(robot.output / "listener.journal")]
    spoken = list(read_journal(robot.output / "speaker.journal"))[: len(heard)]
    times_s = [int(line[2]) / 1e9 for line in spoken]
    figures.scans = (len(spoken), len(heard))
    figures.longest_pause_s = max(b - a for a, b in pairwise(times_s))
    if heard != [int(line[1]) for line in spoken]:
        figures.failures.append("scans were lost inside the robot")
    if any(line[0] == "R" for line in spoken):
        figures.failures.append("scans were refused")
