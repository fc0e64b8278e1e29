"""Goals for the stock robot's navigation, sent from the command line."""

import json
import os
import signal
import subprocess
import time

import pytest

from tests.robot._support.stock_robot import StockRobot

pytestmark = pytest.mark.timeout(150)
LIMIT_S = 60.0


def goal_at(x_m: float, frame: str = "map") -> str:
    return f"{{pose: {{header: {{frame_id: {frame}}}, pose: {{position: {{x: {x_m}}}}}}}}}"


def pid_of(robot: StockRobot, name: str, besides: int = 0) -> int:
    """Wait until a module runs, with another process than the given one."""
    deadline = time.monotonic() + LIMIT_S
    while time.monotonic() < deadline:
        module = robot.top().get(name)
        if module is not None and module["state"] == "RUNNING" and module["pid"] != besides:
            return int(module["pid"])
    raise AssertionError(f"{name} does not run")


def call(robot: StockRobot, *arguments: str) -> subprocess.Popen[str]:
    return robot.attach("call", *arguments, "--json")


def test_goals_are_reached_refused_and_cancelled_and_survive_the_death_of_navigation(
    robot: StockRobot,
) -> None:
    robot.start("navigation", "--set", "navigation.max_linear_m_per_s=0.1")
    killed = pid_of(robot, "navigation")
    driving = call(robot, "NavigateTo", goal_at(0.6))
    told = [driving.stdout.readline()]  # type: ignore[union-attr]
    os.kill(killed, signal.SIGKILL)
    rest, errors = driving.communicate(timeout=LIMIT_S)
    assert driving.returncode == 0, errors
    told += rest.splitlines()
    assert pid_of(robot, "navigation") != killed
    assert "DRIVE" in {json.loads(line)["state"] for line in told[:-1]}
    assert json.loads(told[-1])["duration_s"] > 1.0
    refused = call(robot, "NavigateTo", goal_at(1.5, "odom"))
    assert refused.communicate(timeout=LIMIT_S)[1] == "a goal must be given in the frame 'map', not 'odom'\n"
    away = call(robot, "NavigateTo", goal_at(2.5))
    assert away.stdout.readline()  # type: ignore[union-attr]
    cancel = call(robot, "CancelNavigation", "{reason: enough}")
    client = json.loads(cancel.communicate(timeout=LIMIT_S)[0])["client"]
    assert client.startswith("~tool")
    assert away.communicate(timeout=LIMIT_S)[1] == "enough\n"
    assert (refused.returncode, cancel.returncode, away.returncode) == (1, 0, 1)
    offered = robot.attach("list", "services", "--json").communicate(timeout=LIMIT_S)[0]
    assert "robbie_msgs/action/NavigateTo" in offered
    assert "robbie_msgs/srv/CancelNavigation" in offered
