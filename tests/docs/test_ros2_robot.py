"""Follows docs/ros2-robot.md with real nodes of ROS 2; see `make ros`. Only domain and port are others."""

import math
import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil
import pytest

import robbie_mp
from robbie_mp.base.linux.fastdds_memory import remove_dead_participants
from robbie_mp.messages import Odometry
from tests._support.robot import Robot, wait_until
from tests.connect.ros2._support.ros_nodes import WHEELS, ros_python
from tests.docs._support.pages import ROOT, block, blocks

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler: g++"),
]
PAGE = "docs/ros2-robot.md"
DOMAIN = 200 + os.getpid() % 16
STANDS_WITHIN_S = 0.4
"""What the page says."""
STANDING_M_PER_S, STANDING_RAD_PER_S = 0.01, 0.02
PROGRAMS = {"driver": ["./laser_driver"], "wander": ["python3", "wander.py"]}
PERIOD_S = 0.05
"""Of the base's odometry."""
HOME_M = 0.4
"""Navigation's tolerance, and what the map may be off."""


class Speeds:
    """Listens to how the robot moves, in a thread."""

    def __init__(self) -> None:
        self.moves: list[tuple[float, bool]] = []
        """Each with the time of the machine, in s, and whether the robot moved."""
        self.is_over = False
        self._thread = threading.Thread(target=self._listen)

    def _listen(self) -> None:
        with robbie_mp.attach() as run, run.listen(Odometry, "odom", max_waiting=1000) as listener:
            for odometry in listener:
                if self.is_over:
                    break
                twist = odometry.twist.twist
                turns = abs(twist.angular.z) > STANDING_RAD_PER_S
                stamp_s = odometry.header.stamp.nanoseconds / 1e9
                self.moves.append((stamp_s, abs(twist.linear.x) > STANDING_M_PER_S or turns))

    def drives(self) -> bool:
        """Return whether it moves now."""
        return bool(self.moves) and self.moves[-1][1]

    def wait_until_it_stands(self, since_s: float) -> float:
        """Wait until the robot has stood after a time; return how long after it, in s.

        What the base's reports were late, because others used the processors, does not count.
        """
        wait_until(lambda: any(stamp_s > since_s and not moves for stamp_s, moves in self.moves))
        stood_s = next(stamp_s for stamp_s, moves in self.moves if stamp_s > since_s and not moves)
        stamps = [stamp_s for stamp_s, _ in self.moves if since_s - PERIOD_S <= stamp_s <= stood_s]
        late_s = sum(max(0.0, later - earlier - PERIOD_S) for earlier, later in pairwise(stamps))
        return stood_s - since_s - late_s


@contextmanager
def speeds() -> Iterator[Speeds]:
    made = Speeds()
    made._thread.start()
    try:
        yield made
    finally:
        made.is_over = True
        made._thread.join(20.0)


class Reader:
    """Follows the page in a workspace."""

    def __init__(self, robot: Robot, distribution: str, monkeypatch: pytest.MonkeyPatch):
        python = ros_python(distribution)
        self.robot, self.python = robot, Path(python.path)
        self.prefix = self.python.parents[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self.port = str(free.getsockname()[1])
        variables = {
            **python.variables,
            "ROS": str(self.prefix),
            "ROS_DOMAIN_ID": str(DOMAIN + WHEELS.index(distribution)),
            "ROS_LOG_DIR": str(robot.folder),
            "PATH": f"{self.python.parent}:{os.environ['PATH']}",
        }
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setenv("LDFLAGS", self.run(f"python3 {ROOT}/tools/ros_wheels.py flags"))

    def write_files(self) -> None:
        """Make the workspace, with each file of the page."""
        new, _ = block(PAGE, "new").splitlines()
        assert self.robot.command(*new.split()[1:]).returncode == 0
        self.robot.folder /= "ros2-robot"
        domain = f"domain: {os.environ['ROS_DOMAIN_ID']}"
        for one in blocks(PAGE):
            if one.mark.startswith("test: file "):
                path = self.robot.folder / one.mark.removeprefix("test: file ")
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(one.text.replace("2368", self.port).replace("domain: 7", domain))

    def run(self, text: str) -> str:
        """Type a command into a shell; return what it prints."""
        done = subprocess.run(
            ["sh", "-ec", text],
            cwd=self.robot.folder,
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.strip()

    def robbie(self, mark: str) -> str:
        """Run the command of `robbie` in a block of the page; return what it prints."""
        done = self.robot.command(*block(PAGE, mark).split()[1:])
        assert done.returncode == 0, done.stderr
        return done.stdout

    def is_listed(self) -> bool:
        """Return whether `robbie list` shows what the page does; a busy machine may restart a program."""
        listed = self.robbie("list").split()
        lines = (line.split() for line in block(PAGE, "listed").splitlines())
        return all(listed[listed.index(name) + 1] == state for name, state in lines)

    def process(self, name: str) -> psutil.Process:
        """Return the process of a program; its module and its guardian are others."""
        tree = psutil.Process(self.robot.top()[name]["pid"]).children(recursive=True)
        command = PROGRAMS[name]
        (found,) = [one for one in tree if one.cmdline()[: len(command)] == command]
        return found


@pytest.fixture(params=WHEELS)
def reader(request: pytest.FixtureRequest, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> Iterator[Reader]:
    yield Reader(robot, request.param, monkeypatch)
    robot.close()
    remove_dead_participants()


def is_back(name: str, restarts: int, top: dict[str, dict[str, Any]]) -> bool:
    """Return whether a program runs again that was restarted as often before."""
    return bool(top[name]["restarts"] > restarts and top[name]["state"] == "RUNNING")


def test_robot_of_the_page_drives_survives_two_deaths_and_comes_home(reader: Reader) -> None:
    reader.write_files()
    reader.run(block(PAGE, "compile"))
    reader.run(f"python3 {ROOT}/tools/ros_wheels.py interfaces interfaces/nav2_msgs .")
    robot = reader.robot
    robot.start(profile="ros2-robot")
    robot.until(lambda top: all(one["state"] == "RUNNING" for one in top.values()))
    wait_until(reader.is_listed)
    with speeds() as moves:
        for name in PROGRAMS:
            wait_until(moves.drives)
            process = reader.process(name)
            restarts = robot.top()[name]["restarts"]
            since_s = time.time()
            process.kill()
            stood_s = moves.wait_until_it_stands(since_s)
            print(f"{name} killed: the robot stood after {stood_s:.2f} s")
            assert stood_s < STANDS_WITHIN_S
            robot.until(partial(is_back, name, restarts))
        wait_until(moves.drives)
    reader.robbie("stop wander")
    assert reader.run(block(PAGE, "send home")) == block(PAGE, "sent home").strip()
    with robbie_mp.attach() as run:
        place = run.latest(Odometry, "ground_truth").pose.pose.position
    assert math.hypot(place.x, place.y) < HOME_M
