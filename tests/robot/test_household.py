"""The household robot, run as a user runs it: it brings an object to a person, in lockstep."""

from pathlib import Path

import pytest

from tests.robot._support.stock_robot import StockRobot
from tools.trials.missions.household import NOISY, OrderResult, apartment, judge, plan_of
from tools.trials.missions.mission import settings_for

pytest.importorskip("pinocchio", reason="arms need the extra 'arm'")
# The time of the order is simulated, but that of the machine is not; on a busy one it takes its time.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_robot_finds_an_object_and_hands_it_to_the_person_who_wants_it(
    robot: StockRobot, tmp_path: Path
) -> None:
    text, on = apartment(1)
    (tmp_path / "apartment.yaml").write_text(text)
    plan = plan_of("bring", 1, on)
    settings = settings_for("household-fast", tmp_path / "apartment.yaml", 1, NOISY)
    settings.append(f'household.start_orders=["{plan.order}"]')
    words = [word for setting in settings for word in ("--set", setting)]
    exit_code, _modules, errors = robot.run("household-fast", *words, timeout_s=580.0)
    assert exit_code == 0, errors
    outcome = OrderResult(seed=1, task="bring")
    judge(outcome, plan, robot.output)
    assert outcome.reasons == []
    assert (outcome.fallen, outcome.contacts, outcome.collisions) == ([], 0, 0)
    assert outcome.is_right, outcome.places
