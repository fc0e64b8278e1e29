"""The task "follow me": whom the robot follows, when it stands, and how it finds a lost person again."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_mp.base.state_machine import mermaid
from robbie_robots.workers.home.follow import (
    ARE_YOU_THERE,
    FOUND,
    GIVEN_UP,
    I_FOLLOW,
    NOBODY,
    STAND_IN_FRONT,
    STOPPED,
    Follow,
    FollowOrders,
    PersonReport,
)
from robbie_robots.workers.home.follow_states import TRANSITIONS, FollowSettings, FollowState
from robbie_robots.workers.people.clothes import PART_BINS
from tests._support.places import PROJECT

Array = NDArray[np.float64]


def clothes(colour: int) -> Array:
    worn = np.zeros((2, PART_BINS))
    worn[:, colour] = 1.0
    return worn.ravel()


class Scene:
    """A robot, and persons around it, at 10 Hz."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.task = Follow(lambda: self.now_s)
        self.pose = (0.0, 0.0, 0.0)
        self.persons: dict[str, tuple[float, float]] = {}
        self.worn: dict[str, Array] = {}
        self.said: list[str] = []

    def run(self, seconds: float = 0.1) -> FollowOrders:
        orders = FollowOrders()
        for _ in range(round(seconds * 10)):
            self.now_s += 0.1
            self.task.see_pose(self.pose)
            self.task.see_persons([PersonReport(name, xy) for name, xy in self.persons.items()])
            self.task.see_clothes({name: worn for name, worn in self.worn.items() if name in self.persons})
            orders = self.task.step()
            self.said += self.task.sayings()
        return orders

    def begin(self) -> None:
        """Follow person 1, dressed in colour 1, who stands in front."""
        self.persons["1"], self.worn["1"] = (1.2, 0.0), clothes(1)
        assert self.task.order_follow()
        self.run(1.0)
        assert (self.task.state, self.task.person) == (FollowState.STAND, "1")

    def lose(self, at: tuple[float, float] = (3.0, 0.0)) -> None:
        """Let person 1 walk away and vanish."""
        self.persons["1"] = at
        self.run(0.5)
        del self.persons["1"]
        self.run(1.0)
        assert self.task.state is FollowState.LOST


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_robot_follows_nobody_before_it_is_told_to(scene: Scene) -> None:
    scene.persons["1"] = (1.2, 0.0)
    assert scene.run(3.0) == FollowOrders()
    assert scene.task.state is FollowState.IDLE


def test_it_takes_the_nearest_person_in_front_and_says_so(scene: Scene) -> None:
    scene.persons = {"1": (2.2, 0.2), "2": (1.3, 0.1), "3": (0.2, 0.9), "4": (0.3, 0.0)}
    scene.task.order_follow()
    scene.run()
    assert scene.task.person == "2"
    assert scene.said == [I_FOLLOW]


def test_it_says_that_nobody_is_there_and_waits_for_an_order_again(scene: Scene) -> None:
    scene.persons["1"] = (-1.0, 0.0)
    scene.task.order_follow()
    scene.run(9.0)
    assert (scene.task.state, scene.said) == (FollowState.IDLE, [NOBODY])


def test_it_drives_to_the_persons_own_way_one_metre_behind(scene: Scene) -> None:
    scene.begin()
    for step in range(21):  # ahead, and then around a corner to the left
        scene.persons["1"] = (1.2 + 0.1 * step, 0.0)
        scene.run()
    for step in range(9):
        scene.persons["1"] = (3.2, 0.1 * step)
        scene.run()
    orders = scene.run(1.0)
    assert scene.task.state is FollowState.FOLLOW
    assert orders.goal is not None
    np.testing.assert_allclose(orders.goal[:2], (3.0, 0.0), atol=0.25)
    assert orders.look_at_xy_m == pytest.approx((3.2, 0.8))


def test_it_stands_when_it_is_near_and_drives_on_when_the_person_has_left(scene: Scene) -> None:
    scene.begin()
    assert scene.run().goal is None
    scene.persons["1"] = (2.0, 0.0)
    assert scene.run(0.5).goal is not None
    scene.pose = (0.9, 0.0, 0.0)
    assert scene.run(0.5).goal is None
    assert scene.task.state is FollowState.STAND


def test_goals_are_not_renewed_for_every_step(scene: Scene) -> None:
    scene.begin()
    goals = []
    for step in range(30):
        scene.persons["1"] = (2.0 + 0.06 * step, 0.0)
        goals.append(scene.run().goal)
    different = {tuple(goal) for goal in goals if goal is not None}
    assert 3 <= len(different) <= 9


def test_lost_robot_drives_to_where_the_person_was_seen_last_and_takes_the_same_track_again(
    scene: Scene,
) -> None:
    scene.begin()
    scene.lose((3.0, 0.5))
    orders = scene.run()
    assert orders.goal is not None
    np.testing.assert_allclose(orders.goal[:2], (3.0, 0.5))
    scene.persons["1"] = (3.3, 0.5)
    scene.run(0.3)
    assert scene.task.state in (FollowState.STAND, FollowState.FOLLOW)
    assert (scene.task.person, scene.task.losses, scene.said) == ("1", 1, [I_FOLLOW])


def test_it_recognises_a_new_track_by_clothes_and_passes_by_somebody_else(scene: Scene) -> None:
    scene.begin()
    scene.lose()
    scene.persons["7"], scene.worn["7"] = (2.5, 0.0), clothes(40)
    scene.run(1.5)
    assert scene.task.state is FollowState.LOST
    scene.persons["8"], scene.worn["8"] = (3.5, 0.5), clothes(1)
    scene.run(0.5)
    assert scene.task.person == "8"


def test_it_asks_if_two_persons_are_dressed_alike(scene: Scene) -> None:
    scene.begin()
    scene.lose()
    for name, y in (("7", 0.5), ("8", -0.6)):
        scene.persons[name], scene.worn[name] = (2.0, y), clothes(1)
    scene.run(19.0)
    assert scene.task.state is FollowState.ASK
    assert scene.said[1:] == [ARE_YOU_THERE]
    assert scene.task.order_here()
    scene.run(0.1)  # the nearer one in front of the robot
    assert (scene.task.person, scene.said[-1]) == ("7", FOUND)


def test_here_i_am_of_somebody_dressed_otherwise_is_not_enough(scene: Scene) -> None:
    scene.begin()
    scene.lose()
    scene.persons["7"], scene.worn["7"] = (1.5, 0.0), clothes(40)
    scene.run(19.0)
    scene.task.order_here()
    scene.run(9.0)
    assert scene.task.state is FollowState.ASK
    assert STAND_IN_FRONT in scene.said


def test_person_who_walks_faster_than_anybody_is_somebody_else(scene: Scene) -> None:
    scene.begin()
    scene.lose()
    scene.persons["7"], scene.worn["7"] = (12.0, 9.0), clothes(1)
    scene.run(1.0)
    assert scene.task.state is FollowState.LOST


def test_it_asks_and_gives_up_in_the_end(scene: Scene) -> None:
    scene.begin()
    scene.lose()
    scene.run(60.0)
    assert scene.task.state is FollowState.IDLE
    assert scene.said == [I_FOLLOW, ARE_YOU_THERE, ARE_YOU_THERE, ARE_YOU_THERE, GIVEN_UP]
    assert scene.run() == FollowOrders()


def two_rooms() -> NDArray[np.int8]:
    """Return a map of 8 m by 6 m, corner at (-1, -3): a wall at x = 3.5 m with a door at its upper end."""
    cells = np.zeros((120, 160), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    cells[:100, 88:92] = 100
    return cells


def test_it_searches_behind_the_door_for_a_person_whom_it_sees_nowhere(scene: Scene) -> None:
    scene.begin()
    scene.lose((3.0, 0.0))
    scene.pose = (2.4, 0.0, 0.0)
    scene.task.see_map(two_rooms(), 0.05, (-1.0, -3.0))
    scene.task.arrived()
    goals = []
    for _ in range(300):
        goal = scene.run().goal
        if scene.task.state is FollowState.SEARCH and goal is not None:
            goals.append(goal)
            away = goal[:2] - scene.pose[:2]
            if math.hypot(*away) < 0.6:  # as near as navigation drives
                scene.task.arrived()
                continue
            x, y = scene.pose[:2] + 0.07 * away / math.hypot(*away)
            scene.pose = (float(x), float(y), float(goal[2]))
    assert max(goal[0] for goal in goals) > 4.0
    assert scene.said == [I_FOLLOW]
    scene.persons["9"], scene.worn["9"] = (6.0, 1.0), clothes(1)
    scene.run(0.5)
    assert scene.task.person == "9"


def test_place_that_cannot_be_reached_is_searched_no_more(scene: Scene) -> None:
    scene.begin()
    scene.lose((3.0, 0.0))
    scene.pose = (2.4, 0.0, 0.0)
    scene.task.see_map(two_rooms(), 0.05, (-1.0, -3.0))
    scene.task.arrived()
    first = scene.run(6.0).goal
    assert first is not None
    scene.task.unreachable("no way")
    second = scene.run(1.0).goal
    assert second is not None
    assert math.dist(first[:2], second[:2]) > 0.5


def test_camera_looks_at_everybody_who_may_be_the_lost_person(scene: Scene) -> None:
    scene.begin()
    scene.lose()
    for name, y in (("7", 1.0), ("8", -1.0)):
        scene.persons[name], scene.worn[name] = (2.0, y), clothes(40)
    del scene.worn["7"]  # never seen well
    assert scene.run(1.0).look_at_xy_m == (2.0, 1.0)  # 8 wears other clothes


def test_it_notices_that_its_track_went_over_to_somebody_else(scene: Scene) -> None:
    scene.begin()
    scene.persons["1"] = (1.6, 0.0)
    scene.run(0.3)
    scene.worn["1"] = clothes(40)  # the tracker has taken another person's legs
    scene.persons["1"] = (1.6, 0.7)
    scene.run(0.5)
    assert scene.task.state is FollowState.LOST
    assert scene.task.last_xy_m == (1.6, 0.0)  # there, not where the other person is
    scene.run(1.0)
    assert scene.task.state is FollowState.LOST  # the track is there, but it is another person's
    scene.persons["2"], scene.worn["2"] = (1.5, 0.5), clothes(1)
    scene.run(0.5)
    assert scene.task.person == "2"


def test_without_a_camera_a_near_bystander_makes_it_ask(scene: Scene) -> None:
    scene.persons["1"] = (1.2, 0.0)
    scene.task.order_follow()
    scene.run(0.5)
    scene.lose()
    scene.persons["1"], scene.persons["2"] = (3.0, 0.0), (3.5, 0.4)
    scene.run(0.5)
    assert scene.task.state is FollowState.LOST
    scene.persons["2"] = (3.0, 3.0)
    scene.run(0.2)
    assert scene.task.state in (FollowState.STAND, FollowState.FOLLOW)


def test_stop_ends_it_in_every_state(scene: Scene) -> None:
    assert not scene.task.order_stop()
    scene.begin()
    assert scene.task.order_stop()
    scene.run()
    assert (scene.task.state, scene.said[-1]) == (FollowState.IDLE, STOPPED)
    scene.persons["1"] = (1.2, 0.0)
    scene.begin()
    scene.lose()
    assert scene.task.order_stop()
    assert scene.task.state is FollowState.IDLE


def test_robot_that_cannot_drive_stands_and_then_searches(scene: Scene) -> None:
    scene.begin()
    scene.task.see_stopped("EMERGENCY_STOP: button")
    assert scene.run().goal is None
    assert scene.task.state is FollowState.HALT
    scene.task.see_stopped(None)
    scene.run(0.3)
    assert scene.task.state.name == "STAND"


def test_restarted_task_goes_on_with_the_same_person(scene: Scene) -> None:
    scene.begin()
    memory = scene.task.memory()
    scene.task = Follow(lambda: scene.now_s)
    scene.task.remember(memory)
    assert scene.task.state is FollowState.LOST
    scene.persons["2"], scene.worn["2"] = (1.1, 0.3), clothes(40)
    scene.run(0.5)
    assert (scene.task.state, scene.task.person) == (FollowState.STAND, "1")
    assert math.isfinite(scene.task.unseen_s)


def test_state_diagram_in_the_documentation_matches_the_declaration() -> None:
    page = (PROJECT / "docs" / "home.md").read_text()
    assert mermaid(FollowState.IDLE, TRANSITIONS, FollowSettings().time_outs()) in page


def test_restarted_task_that_was_not_ordered_waits(scene: Scene) -> None:
    again = Follow(lambda: 0.0)
    again.remember(scene.task.memory())
    assert again.state is FollowState.IDLE


def test_person_hidden_for_a_moment_is_believed_on_the_own_course(scene: Scene) -> None:
    scene.begin()
    scene.now_s += 0.1
    scene.task.see_persons([PersonReport("1", (1.8, 0.4), (1.0, 0.5), unseen_s=0.6)])
    assert scene.task.believed_xy_m == (1.8, 0.4)
    assert scene.task.last_xy_m == (1.2, 0.0)
    scene.task.see_persons([])
    assert scene.task.believed_xy_m == (1.2, 0.0)
