"""The robot with the arm, run as a user runs it: it brings one object of two that look alike, in lockstep."""

from pathlib import Path

import pytest

from robbie_robots.hw.simulation.table_room import generate_room
from tests.robot._support.stock_robot import StockRobot
from tests.robot._support.twins import twins_settings
from tools.trials.missions.grasp import NOISY, GraspResult, judge
from tools.trials.missions.mission import settings_for

pytest.importorskip("pinocchio", reason="arms need the extra 'arm'")
pytest.importorskip("cv2", reason="recognition of objects needs the extra 'vision'")
# The time of the orders is simulated, but that of the machine is not; on a busy one it takes its time.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_robot_brings_the_object_that_was_taught_and_not_another_of_its_size(
    robot: StockRobot, tmp_path: Path
) -> None:
    room = tmp_path / "room.yaml"
    room.write_text(generate_room(0, has_twins=True))
    settings = settings_for("arm-fast", room, 0, NOISY) + twins_settings(0, room, tmp_path)
    words = [word for setting in settings for word in ("--set", setting)]
    exit_code, _modules, errors = robot.run("arm-fast", *words, timeout_s=580.0)
    assert exit_code == 0, errors
    outcome = GraspResult(seed=0)
    judge(outcome, robot.output)
    assert (outcome.right, outcome.orders, outcome.reasons) == (1, 1, [])
    assert (outcome.fallen, outcome.slips, outcome.contacts, outcome.touches) == ([], 0, 0, 0)
    assert outcome.is_right
