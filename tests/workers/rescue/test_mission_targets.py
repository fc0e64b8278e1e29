"""The robots of a team part: each takes the targets at which its way is shorter than those of the others."""

import numpy as np
import pytest

from robbie_robots.workers.exploration.team_claims import Claim, SeenInVain, TeamClaims
from robbie_robots.workers.rescue.mission_states import MissionSettings, MissionState
from robbie_robots.workers.rescue.mission_targets import MissionMap, MissionTargets, SearchedGrid
from robbie_robots.workers.rescue.searched_walls import NOTHING, SEARCHED, UNSEARCHED

RESOLUTION_M = 0.05
MIDDLE = np.array([4.0, 1.0, np.pi / 2])


def corridor() -> MissionMap:
    """A corridor of 8 m x 2 m whose walls are known, and whose ends nobody has seen."""
    cells = np.full((40, 200), -1, np.int8)
    cells[:, 20:180] = 0
    cells[[0, -1], 20:180] = 100
    return MissionMap(cells, RESOLUTION_M, (-1.0, 0.0), MissionSettings())


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


def left_by_others(kind: MissionState) -> bool:
    """Whether the robot goes to the far end after blue was at the near one, for a target of this kind."""
    alone = chosen_x_m(3.8, None)
    vain = (SeenInVain(kind.name, (alone, 1.0)),)
    claims = TeamClaims(lambda: 0.0)
    away = Claim(np.array([30.0, 1.0, 0.0]), None, None, 0.0, is_working=False, seen_in_vain=vain)
    claims.see("blue", away, valid_s=1.0)
    targets = MissionTargets(MissionSettings())
    target, _ = targets.best(corridor(), np.array([3.8, 1.0, np.pi / 2]), None, [], None, claims)
    assert target is not None
    return abs(float(target.about_xy_m[0]) - alone) > 6.0


def test_robot_does_not_go_where_another_one_was_in_vain() -> None:
    assert left_by_others(MissionState.EXPLORE)
    assert not left_by_others(MissionState.SEARCH), "blue looked at a wall there; it did not explore"


def test_others_hear_only_of_targets_at_which_the_robot_was() -> None:
    targets = MissionTargets(MissionSettings())
    pose = np.array([3.8, 1.0, np.pi / 2])
    near, _ = targets.best(corridor(), pose, None, [], None, TeamClaims(lambda: 0.0))
    assert near is not None
    targets.give_up(near, was_there=True)
    far, _ = targets.best(corridor(), pose, None, [], None, TeamClaims(lambda: 0.0))
    assert far is not None
    targets.give_up(far, was_there=False)
    again = MissionTargets(MissionSettings())
    again.remember(targets.memory())
    for one in (targets, again):
        assert [seen.about_xy_m for seen in one.seen_in_vain] == [tuple(near.about_xy_m.tolist())]
        assert one.best(corridor(), pose, None, [], None, TeamClaims(lambda: 0.0)) == (None, True)


@pytest.mark.parametrize(("unsearched", "counts"), [(4, True), (6, False)])
def test_what_another_robot_found_too_short_counts_as_searched(unsearched: int, counts: bool) -> None:
    cells = np.full((20, 60), NOTHING, np.int8)
    cells[10, 10:50] = SEARCHED
    cells[10, 28 : 28 + unsearched] = UNSEARCHED
    cells[3, 10:14] = UNSEARCHED  # blue has seen these from afar, and searched nothing near
    seen = SearchedGrid(cells, RESOLUTION_M, (0.0, 0.0)).widened(min_wall_m=0.3)
    middle = np.array([[(28 + unsearched / 2) * RESOLUTION_M, 10.5 * RESOLUTION_M + 0.12]])
    assert bool(seen.holds(middle)[0]) == counts
    assert not seen.holds(np.array([[0.6, 3.5 * RESOLUTION_M]]))[0]
