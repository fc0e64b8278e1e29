"""No command moves a robot for long, whatever validity it claims."""

import math

import pytest

from robbie_robots.hw.drive import DriveCommandError
from robbie_robots.hw.drive import capped_validity_s as drives_for_s
from robbie_robots.hw.joints import Joint
from robbie_robots.hw.simulation.joints import SimulatedJoints


def test_command_that_is_valid_for_an_hour_lasts_a_second() -> None:
    assert drives_for_s(0.1, 0.0, 3600.0) == 1.0
    assert drives_for_s(0.1, 0.0, 0.2) == 0.2


@pytest.mark.parametrize("valid_for_s", [0.0, -1.0, math.nan, math.inf])
def test_validity_that_is_no_positive_number_is_an_error(valid_for_s: float) -> None:
    with pytest.raises(DriveCommandError):
        drives_for_s(0.1, 0.0, valid_for_s)


def test_joints_are_let_go_a_second_after_a_command_that_claims_an_hour() -> None:
    now_s = 0.0
    joints = SimulatedJoints([Joint("arm", speed_rad_per_s=0.1)], lambda: now_s)
    joints.command({"arm": 3.0}, 3600.0)
    now_s = 10.0
    assert joints.read().positions_rad[0] == pytest.approx(0.1, abs=0.03)
    joints.command({"arm": 3.0}, math.inf)
    now_s = 20.0
    assert joints.read().positions_rad[0] == pytest.approx(1.1, abs=0.06)
