"""Real nodes of ROS 2 for tests: rclpy from wheels (`make ros`), and from the ROS of this shell."""

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.base.linux.fastdds_memory import remove_dead_participants
from robbie_mp.connect.ros2.module import Ros2Bridge
from tests._support.places import PROJECT
from tests._support.robot import wait_until

PROGRAM = Path(__file__).with_name("rclpy_program.py")
INSTALLED = "installed"
"""The ROS of this shell, after `source setup.bash`, with its RMW_IMPLEMENTATION."""
WHEELS = ("jazzy", "kilted")
"""Distributions of which `make ros` installs the wheels, with rmw_fastrtps_cpp."""
DISTRIBUTIONS = (*WHEELS, INSTALLED)


class RosPython(NamedTuple):
    """An interpreter that has rclpy, and the variables of its nodes."""

    path: str
    variables: dict[str, str]


def ros_python(distribution: str) -> RosPython:
    """Return the interpreter of a distribution; skip the test if there is none."""
    local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    if distribution == INSTALLED:
        if "ROS_DISTRO" not in os.environ:
            pytest.skip("no ROS 2 in this shell: `source /opt/ros/…/setup.bash` makes one known")
        if os.environ.get("RMW_IMPLEMENTATION") == "rmw_zenoh_cpp":
            pytest.skip("these tests are over DDS; test_zenoh.py has Zenoh")
        return RosPython("python3", {**os.environ, **local})
    folder = PROJECT / f".venv/ros-{distribution}"
    if not (folder / "done").exists():
        pytest.skip(f"no wheels of ROS 2 {distribution} here: `make ros` installs them, with Python 3.11")
    kept = {name: os.environ[name] for name in ("PATH", "HOME", "LANG") if name in os.environ}
    return RosPython(str(folder / "bin/python"), {**kept, **local, "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"})


class RosNode:
    """A real node, in a process of its own.

    Attributes:
        middleware: its middleware, as `rmw_fastrtps_cpp`.
    """

    def __init__(self, process: "subprocess.Popen[str]"):
        self._process = process
        self.middleware: str = self._answer()

    def run(self, text: str, **values: object) -> Any:
        """Run Python beside the node, and return its `result`.

        Args:
            text: the program; it knows `node`, `rclpy`, and `got`, a dictionary of lists.
            values: further names in it.
        """
        assert self._process.stdin is not None
        given = "".join(f"{name} = {value!r}\n" for name, value in values.items())
        self._process.stdin.write(json.dumps(given + text) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def kill(self) -> None:
        """Let the node die without a word to anybody."""
        self._process.kill()
        self._process.wait(10)

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, f"the node has ended with exit code {self._process.wait(10)}"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return answer["result"]


@contextmanager
def ros_node(distribution: str, domain: int, folder: Path) -> Iterator[RosNode]:
    """Run a real node.

    Args:
        distribution: one of DISTRIBUTIONS.
        domain: its ROS_DOMAIN_ID.
        folder: where its log goes.
    """
    python = ros_python(distribution)
    variables = {**python.variables, "ROS_LOG_DIR": str(folder)}
    command = [python.path, str(PROGRAM), str(domain)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=variables) as process:
        try:
            yield RosNode(process)
            process.communicate(timeout=10)
        finally:
            process.kill()
            process.wait()
            remove_dead_participants()  # a test may have killed it


def until(bridge: ModuleHarness[Ros2Bridge], condition: Any, limit_s: float = 30.0) -> None:
    """Advance a bridge until a condition is true."""

    def is_true() -> bool:
        bridge.advance(0.02)
        return bool(condition())

    wait_until(is_true, limit_s)
