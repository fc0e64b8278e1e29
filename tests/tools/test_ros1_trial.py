"""A robot beside the real roscore, rospy and rostopic: both ways, and through a few deaths."""

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from robbie_mp.logs.capture.recorded_run import RecordedRun
from tests.connect.ros1._support.ros import needs_ros1
from tools.journal import read_journal
from tools.robot import Robot
from tools.ros1.ros import Ros
from tools.ros1.trial import ALL, SCAN, robot_beside, run_trial

pytestmark = [pytest.mark.slow, pytest.mark.every_turn, needs_ros1]
SPEED_M_PER_S, VALID_S = 0.25, 0.3


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Ros]:
    with closing(Ros(tmp_path)) as ros:
        yield ros


def told(robot: Robot, what: str) -> list[list[str]]:
    """What the base has been told, with the time."""
    return [line[1:] for line in read_journal(robot.output / "base.journal") if line[0] == what]


def recorded_run(robot: Robot) -> RecordedRun:
    """The run as a recorder sees it that starts now, before ROS does."""
    return RecordedRun(robot.output.parent / "runtime" / "robbie" / robot.run_id)


def test_robot_and_ros_hear_each_other_whoever_dies(ros: Ros, tmp_path: Path) -> None:
    with robot_beside(ros, tmp_path) as robot, closing(recorded_run(robot)) as recorded:
        assert robot.figures()["ros1"].restarts == 0  # without a master
        ros.start()
        with ros.witness(
            "witness", {**ALL, **SCAN, "/map": "nav_msgs/OccupancyGrid"}, drives=True
        ) as witness:
            assert witness.read(len(ALL) + 2, limit_s=20.0) == {*ALL, *SCAN, "/map"}
            robot.wait_for(lambda: len(told(robot, "drive")) > 5, "no command has come")
            robot.wait_for(lambda: bool(told(robot, "goal") and told(robot, "pose")), "no goal, or no pose")
            robot.wait_for(lambda: bool(told(robot, "status")), "no message of a type that only ROS knows")
            schema = recorded.schema("actionlib_msgs/msg/GoalStatusArray", 1)
            assert schema and "GoalStatus[] status_list" in schema
            witness.stand_still()
            ended_s = time.monotonic()
            assert "seq:" in ros.rostopic("echo", "-n", "1", "/scan")  # a stopped subscriber stops no other
        commands = told(robot, "drive")
        assert all(
            float(speed) == SPEED_M_PER_S and 0.0 < float(valid) <= VALID_S for speed, valid, _ in commands
        )
        assert int(commands[-1][2]) / 1e9 < ended_s + VALID_S  # a silent ROS node sends no command
        assert [line[0] for line in told(robot, "goal")] == ["2.0"]
        assert [line[0] for line in told(robot, "pose")] == ["3.0"]
        figures = run_trial(ros, robot, kills=3, seed=1, pause_s=0.2)
        assert figures.failures == []
    assert robot.supervisor.returncode == 0
