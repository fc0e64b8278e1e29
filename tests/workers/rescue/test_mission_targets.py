"""The robots of a team part: each takes the targets at which its way is shorter than those of the others."""

import numpy as np
import pytest

from workers.exploration.team_claims import Claim, TeamClaims
from workers.rescue.mission_states import MissionSettings
from workers.rescue.mission_targets import MissionTargets, Surroundings

RESOLUTION_M = 0.05
MIDDLE = np.array([4.0, 1.0, np.pi / 2])


def corridor() -> Surroundings:
    """A corridor of 8 m x 2 m whose walls are known, and whose ends nobody has seen."""
    cells = np.full((40, 200), -1, np.int8)
    cells[:, 20:180] = 0
    cells[[0, -1], 20:180] = 100
    return Surroundings(cells, RESOLUTION_M, (-1.0, 0.0), MissionSettings())


def chosen_x_m(robot_x_m: float, blue_x_m: float | None, *, is_working: bool = True) -> float:
    """Where the robot goes while blue is elsewhere in the corridor and has no target."""
    claims = TeamClaims(lambda: 0.0)
    if blue_x_m is not None:
        pose = np.array([blue_x_m, 1.0, 0.0])
        claims.see("blue", Claim(pose, None, None, 0.0, is_working=is_working), valid_s=1.0)
    pose = MIDDLE.copy()
    pose[0] = robot_x_m
    targets = MissionTargets(MissionSettings())
    target, _ = targets.best(corridor(), pose, None, [], None, claims)
    assert target is not None
    return float(target.about_xy_m[0])


@pytest.mark.parametrize(("robot_x_m", "blue_x_m"), [(3.8, 3.0), (4.2, 5.0), (3.8, 0.5), (4.2, 7.5)])
def test_robot_leaves_the_near_end_to_one_that_is_nearer(robot_x_m: float, blue_x_m: float) -> None:
    alone = chosen_x_m(robot_x_m, None)
    assert abs(alone - robot_x_m) < 4.0
    other_end = chosen_x_m(robot_x_m, blue_x_m)
    assert abs(other_end - alone) > 6.0
    assert chosen_x_m(robot_x_m, blue_x_m, is_working=False) == alone
