"""Driving by spoken orders."""

from collections.abc import Iterator

import pytest

from robbie_mp import GoalAborted, Header, ModuleHarness, Time
from robbie_mp.messages import (
    AnnotateMap,
    CancelNavigation,
    MapAnnotated,
    NavigateTo,
    NavigationCancelled,
    NavigationResult,
    Point,
    Pose,
    PoseStamped,
)
from robbie_robots.modules.speech.messages import Say, SpokenOrder, SpokenSlot
from robbie_robots.modules.speech.spoken_navigation import SpokenNavigation
from tests._support.commands import waits


class Robot:
    """A robot to which a test speaks."""

    def __init__(self, harness: ModuleHarness[SpokenNavigation]) -> None:
        self.harness = harness

    def order(self, name: str, place: str = "") -> None:
        slots = [SpokenSlot(name="place", words=place)] if place else []
        self.harness.send(SpokenOrder(order=name, slots=slots))
        self.harness.advance(0.01)

    def said(self) -> list[str]:
        return [say.text for say in self.harness.take(Say)]

    def stand_at(self, x_m: float, ahead_s: float = 0.0) -> None:
        stamp = Time.from_nanoseconds(self.harness.clock.now_ns() + round(ahead_s * 1e9))
        pose = Pose(position=Point(x=x_m))
        self.harness.send(
            PoseStamped(header=Header(stamp=stamp, frame_id="map"), pose=pose), topic="map_pose"
        )
        self.harness.advance(0.01)


@pytest.fixture
def robot() -> Iterator[Robot]:
    with ModuleHarness(SpokenNavigation, name="spoken_navigation") as harness:
        yield Robot(harness)


def test_robot_drives_to_a_place_and_says_when_it_is_there(robot: Robot) -> None:
    robot.order("go", "kitchen")
    (goal,) = robot.harness.take(NavigateTo)
    assert goal.place == "kitchen"
    assert robot.said() == ["I go to the kitchen."]
    robot.harness.end_goal(goal, NavigationResult(duration_s=3.0))
    robot.harness.advance(0.01)
    assert robot.said() == ["I am at the kitchen."]


def test_robot_says_that_it_could_not_drive(robot: Robot) -> None:
    robot.order("go", "kitchen")
    (goal,) = robot.harness.take(NavigateTo)
    robot.harness.end_goal(goal, GoalAborted("no path leads to the goal"))
    robot.harness.advance(0.01)
    assert robot.said()[-1] == "I could not do it."
    assert robot.harness.module.status == "0 orders done, 1 failed"


def test_order_that_waited_in_a_stopped_module_drives_nowhere(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits(robot.harness, monkeypatch, 5.0)
    robot.order("go", "kitchen")
    assert robot.harness.take(NavigateTo) == []
    robot.order("stop")
    assert len(robot.harness.take(CancelNavigation)) == 1


def test_spoken_stop_cancels_the_goals_of_all_modules(robot: Robot) -> None:
    robot.order("stop")
    (cancel,) = robot.harness.take(CancelNavigation)
    assert cancel.client == ""
    robot.harness.reply(cancel, NavigationCancelled())
    robot.harness.advance(0.01)
    assert robot.said() == ["I stopped."]


def test_place_is_learnt_where_the_robot_stands(robot: Robot) -> None:
    robot.stand_at(2.5)
    robot.order("learn", "kitchen")
    (request,) = robot.harness.take(AnnotateMap)
    (place,) = request.places
    assert (place.name, place.pose.position.x) == ("kitchen", 2.5)
    robot.harness.reply(request, MapAnnotated(revision=1))
    robot.harness.advance(0.01)
    assert robot.said() == ["This is the kitchen."]


@pytest.mark.parametrize(("age_s", "ahead_s"), [(None, 0.0), (2.0, 0.0), (0.0, 3600.0), (2.0, 1.95)])
def test_place_is_not_learnt_without_a_pose_of_now(age_s: float | None, ahead_s: float, robot: Robot) -> None:
    if age_s is not None:
        robot.stand_at(2.5, ahead_s)
        robot.harness.advance(age_s)
    robot.order("learn", "kitchen")
    assert robot.harness.take(AnnotateMap) == []
    assert robot.said() == ["I do not know where I am."]


@pytest.mark.parametrize("name", ["bring", "go", "learn"])
def test_other_orders_and_orders_without_a_place_are_left_to_others(name: str, robot: Robot) -> None:
    robot.stand_at(2.5)
    robot.order(name)
    assert robot.harness.published == []
