"""Each robot of a team works out alone which targets are its own, and no target is left to nobody."""

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.exploration.drivable_ground import DrivableGround
from robbie_robots.workers.exploration.team_claims import Claim
from robbie_robots.workers.exploration.team_share import MOST_ON_TOURS, Member, SharedTarget, own_work
from robbie_robots.workers.rescue.mission_states import MissionSettings
from tests._support.present import present

Points = NDArray[np.float64]
RESOLUTION_M = 0.05
HOME = np.array([4.0, 1.0])


def corridor() -> DrivableGround:
    """A corridor of 8 m x 2 m."""
    cells = np.zeros((40, 160), np.int8)
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    return DrivableGround(cells, RESOLUTION_M, (0.0, 0.0), MissionSettings())


AROUND = corridor()


def work_at(x_m: float, *, is_known: bool = True) -> SharedTarget:
    return SharedTarget(np.array([x_m, 1.0, 0.0]), np.array([x_m, 1.8]), 1.0, is_known)


def member(x_m: float, target_x_m: float | None = None) -> Member:
    ways = present(AROUND.ways_from((x_m, 1.0, 0.0)))
    return Member(ways.cost_m, HOME, None if target_x_m is None else np.array([target_x_m, 1.8]))


def claim(x_m: float, target_x_m: float | None = None) -> Claim:
    target = None if target_x_m is None else np.array([target_x_m, 1.8])
    return Claim(np.array([x_m, 1.0, 0.0]), None, target, 1.0, is_working=True, home_xy_m=HOME)


def own(
    x_m: float, blue: Claim | None, works: list[SharedTarget], target_x_m: float | None = None
) -> list[int]:
    return own_work(AROUND, member(x_m, target_x_m), works, [] if blue is None else [blue])


def test_robot_alone_has_all_the_work() -> None:
    assert own(4.0, None, [work_at(1.0), work_at(7.0)]) == [0, 1]


def test_two_robots_take_complementary_shares() -> None:
    works = [work_at(x_m) for x_m in (0.8, 2.0, 3.0, 5.0, 6.0, 7.2)]
    assert sorted(own(3.5, claim(4.5, 6.0), works, 2.0)) == [0, 1, 2]
    assert sorted(own(4.5, claim(3.5, 2.0), works, 6.0)) == [3, 4, 5]


def test_robot_has_nothing_to_do_if_the_other_does_the_rest_on_its_way() -> None:
    assert own(1.0, claim(7.2, 6.0), [work_at(6.0), work_at(5.0)]) == []


def test_work_is_left_to_nobody_when_no_other_robot_drives_to_any() -> None:
    assert sorted(own(1.0, claim(7.2, None), [work_at(6.0), work_at(5.0)])) == [0, 1]


def test_work_of_which_the_others_do_not_know_stays_with_this_robot() -> None:
    assert own(1.0, claim(7.2, 6.0), [work_at(6.0), work_at(7.0, is_known=False)]) == [1]


def test_rest_of_very_much_work_belongs_to_the_nearest_robot() -> None:
    works = [work_at(x_m) for x_m in np.linspace(0.6, 7.4, 2 * MOST_ON_TOURS)]
    red = own(2.0, claim(6.0, 6.0), works, 2.0)
    blue = own(6.0, claim(2.0, 2.0), works, 6.0)
    assert len(red) == len(set(red))
    assert not set(red) & set(blue)
    assert set(red) | set(blue) == set(range(len(works)))
