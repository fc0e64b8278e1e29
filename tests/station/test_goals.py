"""Goals in turn, and the trail of the robot."""

from collections.abc import Callable
from typing import Any

import pytest

from robbie_mp.messages import NavigationResult, Point, Pose, PoseStamped, TimeJump
from robbie_mp.module.calls.errors import GoalAborted
from robbie_mp.module.envelope import Envelope
from robbie_mp.station.map.goals import GOAL, MAX_GOALS, NEXT_GOAL, GoalList, Placement
from robbie_mp.station.map.trail import MAX_POINTS, Trail
from robbie_mp.station.page.requests import Asked
from robbie_mp.station.watch.latest import Latest


class Sent:
    """Goals that were sent, and how they end."""

    def __init__(self) -> None:
        self.places: list[float] = []
        self.asked: list[Asked] = []

    def __call__(self, placement: Placement) -> Asked:
        self.places.append(placement.x_m)
        self.asked.append(Asked("the goal"))
        return self.asked[-1]

    def newest(self) -> Asked | None:
        return self.asked[-1] if self.asked else None


@pytest.fixture
def sent() -> Sent:
    return Sent()


@pytest.fixture
def goals(sent: Sent) -> GoalList:
    made = GoalList(sent, sent.newest)
    for x_m in (1.0, 2.0, 3.0):
        assert made.add(Placement(NEXT_GOAL, x_m, 0.0, None))
    return made


def test_next_goal_is_sent_when_the_robot_has_reached_the_last_one(goals: GoalList, sent: Sent) -> None:
    goals.tick()
    assert sent.places == [1.0]
    sent.asked[0].end(NavigationResult())
    goals.tick()
    assert (sent.places, [goal.x_m for goal in goals.waiting]) == ([1.0, 2.0], [3.0])


def test_goal_that_is_started_takes_the_place_of_all_others_and_the_next_waits_for_it(
    goals: GoalList, sent: Sent
) -> None:
    goals.start(Placement(GOAL, 7.0, 0.0, None))
    goals.add(Placement(NEXT_GOAL, 8.0, 0.0, None))
    assert (sent.places, [goal.x_m for goal in goals.waiting]) == ([1.0, 7.0], [8.0])
    sent.asked[1].end(NavigationResult())
    goals.tick()
    assert sent.places == [1.0, 7.0, 8.0]


def test_goal_that_is_set_elsewhere_takes_the_place_of_all_others_and_the_next_waits_for_it(
    goals: GoalList, sent: Sent
) -> None:
    sent(Placement(GOAL, 7.0, 0.0, None))
    goals.add(Placement(NEXT_GOAL, 8.0, 0.0, None))
    assert (sent.places, [goal.x_m for goal in goals.waiting]) == ([1.0, 7.0], [8.0])
    sent.asked[1].end(NavigationResult())
    goals.tick()
    assert sent.places == [1.0, 7.0, 8.0]


def test_goal_that_fails_ends_the_list(goals: GoalList, sent: Sent) -> None:
    sent.asked[0].end(GoalAborted("a wall"))
    goals.tick()
    assert (sent.places, goals.waiting) == ([1.0], [])
    goals.add(Placement(NEXT_GOAL, 5.0, 0.0, None))
    assert sent.places == [1.0, 5.0]


def test_goal_that_has_just_failed_ends_none_that_is_added_afterwards(goals: GoalList, sent: Sent) -> None:
    sent.asked[0].end(GoalAborted("a wall"))
    goals.add(Placement(NEXT_GOAL, 5.0, 0.0, None))
    assert (sent.places, goals.waiting) == ([1.0, 5.0], [])


def test_goal_that_is_not_sent_ends_the_list(
    goals: GoalList, sent: Sent, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Sent, "__call__", lambda _sent, _placement: None)
    sent.asked[0].end(NavigationResult())
    goals.tick()
    assert (sent.places, goals.waiting) == ([1.0], [])


def test_last_goal_can_be_taken_back(goals: GoalList) -> None:
    goals.undo()
    assert [goal.x_m for goal in goals.waiting] == [2.0]
    goals.undo()
    goals.undo()
    assert goals.waiting == []


def test_goals_that_wait_are_removed_and_put_in_order(goals: GoalList) -> None:
    second, third = goals.waiting
    goals.move_up(third)
    assert goals.waiting == [third, second]
    goals.move_up(third)
    goals.remove(third)
    assert goals.waiting == [second]
    for gone in (goals.remove, goals.move_up):  # the robot has meanwhile begun to drive there
        gone(third)
    assert goals.waiting == [second]


def test_list_of_goals_is_bounded(goals: GoalList) -> None:
    added = [goals.add(Placement(NEXT_GOAL, 0.0, 0.0, None)) for _ in range(MAX_GOALS)]
    assert added.count(True) == MAX_GOALS - 2


class Source:
    """Poses of a robot, and jumps of time."""

    def __init__(self) -> None:
        self.poses: Latest[PoseStamped] = Latest()
        self.jump: Callable[[Any], None] = lambda _jump: None

    @property
    def envelope(self) -> Envelope:
        raise LookupError

    def subscribe(self, *_arguments: Any, **_options: Any) -> None:
        raise AssertionError("a trail needs no other messages")

    def newest(self, _message_type: Any, topic: str = "") -> Any:
        assert topic == "map_pose"
        return self.poses

    def hear(self, message_type: Any, handler: Callable[[Any], None], topic: str = "") -> None:
        assert (message_type, topic) == (TimeJump, "")
        self.jump = handler


def test_trail_is_bounded_and_ends_when_time_jumps() -> None:
    source = Source()
    trail = Trail(source)
    for number in range(4 * MAX_POINTS):
        source.poses.put(PoseStamped(pose=Pose(position=Point(x=0.05 * number))))
    assert len(trail.points) == MAX_POINTS
    assert trail.points[-1][0] - trail.points[-2][0] == pytest.approx(0.1)
    source.jump(TimeJump())
    assert not trail.points
