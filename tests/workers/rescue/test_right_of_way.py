"""Of two robots whose ways meet, the one that is to give way does, and no deadlock lasts."""

import math

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.exploration.team_claims import Claim
from robbie_robots.workers.rescue.mission_states import MissionSettings
from robbie_robots.workers.rescue.mission_targets import MissionMap
from robbie_robots.workers.rescue.right_of_way import CHECK_S, CLEAR_M, LONGEST_S, RightOfWay, way_ahead
from tests._support.present import present
from tests.workers._support.exploration_world import RESOLUTION_M, drawn_cells
from tests.workers._support.mission_world import HALL

AROUND = MissionMap(drawn_cells(HALL), RESOLUTION_M, (0.0, 0.0), MissionSettings())
Pose = NDArray[np.float64]
HERE = np.array([1.6, 0.9, 0.0])
EAST = np.array([3.2, 0.9, 0.0])


class Meeting:
    """A robot at `HERE` that is to give way to another one."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.rule = RightOfWay(lambda: self.now_s)

    def gives_way(
        self,
        other: tuple[float, float],
        other_goal: NDArray[np.float64] | None,
        goal: NDArray[np.float64] | None,
    ) -> bool:
        self.now_s += CHECK_S
        claim = Claim(np.array([*other, 0.0]), other_goal, None, 1.0, is_working=True)
        return self.rule.check(AROUND, HERE, goal, [claim])


def test_robot_gives_way_to_one_that_comes_towards_it() -> None:
    meeting = Meeting()
    assert meeting.gives_way((2.7, 0.9), other_goal=np.array([0.6, 0.9, 0.0]), goal=EAST)


def test_robot_goes_on_if_the_ways_part_or_the_other_is_far_away() -> None:
    meeting = Meeting()
    assert not meeting.gives_way((2.6, 0.9), other_goal=EAST, goal=np.array([0.6, 0.9, 0.0]))
    assert not meeting.gives_way((3.3, 0.9), other_goal=np.array([0.6, 0.9, 0.0]), goal=EAST)


def test_robot_that_stands_in_the_way_goes_aside() -> None:
    meeting = Meeting()
    others_goal = np.array([0.6, 0.9, 0.0])
    assert meeting.gives_way((2.6, 0.9), others_goal, goal=None)
    aside = present(meeting.rule.aside)
    way = way_ahead(AROUND, np.array([2.6, 0.9, 0.0]), others_goal)
    assert min(math.dist(aside[:2], place) for place in way) >= CLEAR_M


def test_robot_that_waits_too_long_goes_on() -> None:
    meeting = Meeting()
    toward = np.array([0.6, 0.9, 0.0])
    while meeting.gives_way((2.7, 0.9), toward, EAST):
        assert meeting.now_s <= LONGEST_S + 2 * CHECK_S
    assert meeting.rule.refused == 1
    assert not meeting.gives_way((2.7, 0.9), toward, EAST)


def test_robot_does_not_wait_for_one_that_stands() -> None:
    meeting = Meeting()
    assert not meeting.gives_way((2.2, 0.9), other_goal=None, goal=EAST)
