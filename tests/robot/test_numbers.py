"""The robot of the numbered signs, run as a user runs it: on a small ground, in lockstep, with a referee."""

import pytest

from tests.robot._support.stock_robot import StockRobot
from tests.workers.numbers.test_board_reader import needs_reader
from tools.trials.missions.numbers import GroundResult, judge

# The time of the task is simulated, but that of the machine is not; on a busy one it takes its time.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900), needs_reader]


def test_robot_reads_the_sheet_and_drives_to_its_digits_in_order(robot: StockRobot) -> None:
    exit_code, _modules, errors = robot.run("numbers-small", timeout_s=880.0)
    assert exit_code == 0, errors
    outcome = GroundResult(seed=0, sheet=True)
    judge(outcome, robot.output)
    assert outcome.reason == "has reached all numbers"
    assert (outcome.right, outcome.wrong, outcome.touches) == (3, 0, 0)
    assert outcome.is_right
    assert 0.0 < outcome.farthest_m <= 1.5
    assert (robot.output / "map.png").exists()
