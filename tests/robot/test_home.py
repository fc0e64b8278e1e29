"""The household robot, run as a user runs it: it follows a person in lockstep, judged by a referee."""

import pytest

from tests.robot._support.stock_robot import StockRobot
from tools.trials.missions.follow import FollowResult, judge

# The time of the task is simulated, but that of the machine is not; on a busy one it takes its time.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_robot_follows_the_person_who_told_it_to(robot: StockRobot) -> None:
    exit_code, _modules, errors = robot.run("home-small", timeout_s=580.0)
    assert exit_code == 0, errors
    outcome = FollowResult(seed=0)
    judge(outcome, robot.output)
    assert outcome.task_s > 10.0
    assert outcome.near_share > 0.9
    assert (outcome.wrong_times, outcome.touches, outcome.collisions) == (0, 0, 0)
    # She has walked more than 5 m by then; the robot was never far.
    assert outcome.farthest_m < 3.5
    assert outcome.is_right
    assert (robot.output / "map.png").exists()
