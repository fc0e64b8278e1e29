"""The robot with the arm, run as a user runs it: it brings one object, in lockstep."""

import pytest

from tests.robot._support.stock_robot import StockRobot
from tools.grasp_trials import Outcome, judge

pytest.importorskip("pinocchio", reason="arms need the extra 'arm'")
# The time of the orders is simulated, but that of the machine is not; on a busy one it takes its time.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_robot_brings_an_object_from_one_table_to_the_other(robot: StockRobot) -> None:
    exit_code, _modules, errors = robot.run(
        "arm-fast", "--set", 'household.start_orders=["put the soup on the counter"]', timeout_s=580.0
    )
    assert exit_code == 0, errors
    outcome = Outcome(seed=0)
    judge(outcome, robot.output)
    assert (outcome.right, outcome.orders, outcome.reasons) == (1, 1, [])
    assert (outcome.fallen, outcome.slips, outcome.contacts, outcome.touches) == ([], 0, 0, 0)
    assert outcome.is_right
