"""Nav2's actions, which become goals of navigation."""

from collections.abc import Iterator

import pytest

from robbie_mp import GoalAborted, GoalCancelled, GoalPreempted, ModuleHarness
from robbie_mp.messages import (
    CallRefusal,
    CancelNavigation,
    GoalCancel,
    GoalEnd,
    Header,
    NavigateTo,
    NavigationCancelled,
    NavigationFeedback,
    NavigationResult,
    Point,
    Pose,
    PoseStamped,
    TimeJump,
)
from robbie_mp.messages.stock.nav2_msgs import (
    FollowedWaypoints,
    FollowingWaypoints,
    FollowWaypoints,
    NavigatedToPose,
    NavigateToPose,
    NavigatingToPose,
)
from robbie_robots.modules.navigation.nav2_actions import IsNavigationActive, Nav2Actions

Harness = ModuleHarness[Nav2Actions]


def at(x_m: float) -> PoseStamped:
    return PoseStamped(header=Header(frame_id="map"), pose=Pose(position=Point(x=x_m)))


@pytest.fixture
def nav2() -> Iterator[Harness]:
    with ModuleHarness(Nav2Actions) as harness:
        harness.advance(0.0)
        yield harness


def driven_to(nav2: Harness) -> NavigateTo:
    """Return the goal that navigation has got since this was called last."""
    (goal,) = nav2.take(NavigateTo)
    return goal


def test_pose_is_a_goal_of_navigation_and_its_feedback_tells_how_far_the_robot_is(nav2: Harness) -> None:
    nav2.send(at(0.5), topic="map_pose")
    nav2.send_goal(NavigateToPose(pose=at(2.5)))
    goal = driven_to(nav2)
    assert goal.pose == at(2.5)
    nav2.feed_back(goal, NavigationFeedback(state="DRIVE", distance_left_m=2.0))
    nav2.advance(2.0)
    nav2.feed_back(goal, NavigationFeedback(state="BACK_UP", distance_left_m=1.0))
    told = nav2.take(NavigatingToPose)[-1]
    assert told.current_pose == at(0.5)
    assert told.distance_remaining == 1.0
    assert told.number_of_recoveries == 1
    assert told.navigation_time.nanoseconds == told.estimated_time_remaining.nanoseconds == 2_000_000_000
    nav2.end_goal(goal, NavigationResult())
    assert nav2.take(NavigatedToPose)
    assert nav2.checkpoint is None


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (GoalAborted("no path"), GoalEnd.ABORTED),
        (GoalPreempted("another goal"), GoalEnd.PREEMPTED),
        (GoalCancelled("enough"), GoalEnd.CANCELLED),
    ],
)
def test_goal_ends_as_that_of_navigation_does(
    nav2: Harness, error: GoalAborted | GoalPreempted | GoalCancelled, outcome: int
) -> None:
    nav2.send_goal(NavigateToPose(pose=at(2.5)))
    nav2.end_goal(driven_to(nav2), error)
    (end,) = nav2.take(GoalEnd)
    assert (end.outcome, end.reason) == (outcome, str(error))


def test_cancel_reaches_navigation_before_the_client_hears_of_the_end(nav2: Harness) -> None:
    sent = nav2.send_goal(NavigateToPose(pose=at(2.5)))
    goal = driven_to(nav2)
    nav2.cancel_goal(sent, "enough")
    assert nav2.take(GoalCancel)[0].call == goal.call
    assert not nav2.take(GoalEnd)
    nav2.end_goal(goal, GoalCancelled("enough"))
    assert nav2.take(GoalEnd)[0].outcome == GoalEnd.CANCELLED


def test_waypoints_are_driven_to_one_after_the_other_and_again(nav2: Harness) -> None:
    nav2.send_goal(FollowWaypoints(poses=[at(1.0), at(2.0)], goal_index=1, number_of_loops=1))
    for x_m in (2.0, 1.0, 2.0):
        assert not nav2.take(FollowedWaypoints)
        goal = driven_to(nav2)
        assert goal.pose == at(x_m)
        nav2.end_goal(goal, NavigationResult())
    assert [one.current_waypoint for one in nav2.take(FollowingWaypoints)] == [1, 0, 1]
    assert not nav2.take(FollowedWaypoints)[0].missed_waypoints
    assert not nav2.take(NavigateTo)


def test_missed_waypoint_ends_the_goal_or_is_told_in_the_result(nav2: Harness) -> None:
    goal = FollowWaypoints(poses=[at(1.0), at(2.0)])
    nav2.send_goal(goal)
    nav2.end_goal(driven_to(nav2), GoalAborted("a wall"))
    assert nav2.take(GoalEnd)[0].reason == "a wall"
    with ModuleHarness(Nav2Actions, {"stops_on_missed": False}) as going_on:
        going_on.advance(0.0)
        going_on.send_goal(goal)
        going_on.end_goal(driven_to(going_on), GoalAborted("a wall"))
        going_on.end_goal(driven_to(going_on), NavigationResult())
        (missed,) = going_on.take(FollowedWaypoints)[0].missed_waypoints
    assert (missed.index, missed.goal) == (0, at(1.0))


def test_cancelled_waypoints_end_between_two_of_them(nav2: Harness) -> None:
    sent = nav2.send_goal(FollowWaypoints(poses=[at(1.0), at(2.0)]))
    nav2.end_goal(driven_to(nav2), NavigationResult())
    nav2.cancel_goal(sent, "enough")
    nav2.end_goal(driven_to(nav2), GoalCancelled("enough"))
    assert nav2.take(GoalEnd)[0].outcome == GoalEnd.CANCELLED
    assert not nav2.take(NavigateTo)


@pytest.mark.parametrize("is_told_by_navigation_first", [False, True])
def test_no_waypoint_is_driven_to_after_a_jump_of_time(is_told_by_navigation_first: bool) -> None:
    with ModuleHarness(Nav2Actions, {"stops_on_missed": False}) as nav2:
        nav2.advance(0.0)
        nav2.send_goal(FollowWaypoints(poses=[at(1.0), at(2.0)]))
        goal = driven_to(nav2)
        if is_told_by_navigation_first:
            nav2.end_goal(goal, GoalAborted("time jumped: reset"))
            goal = driven_to(nav2)
        nav2.send(TimeJump(reason="reset"))
        assert nav2.take(GoalCancel)[0].call == goal.call
        nav2.end_goal(goal, GoalAborted("time jumped: reset"))
        assert not nav2.take(NavigateTo)
        assert nav2.take(GoalEnd)[0].outcome == GoalEnd.ABORTED
        assert nav2.checkpoint is None


def test_waypoints_without_a_first_one_are_refused(nav2: Harness) -> None:
    nav2.send_goal(FollowWaypoints(poses=[at(1.0)], goal_index=1))
    assert "there is no waypoint 1" in nav2.take(CallRefusal)[0].reason


def test_goals_of_a_process_that_died_are_ended(nav2: Harness) -> None:
    nav2.send_goal(NavigateToPose(pose=at(2.5)))
    with ModuleHarness(Nav2Actions, restored=nav2.checkpoint) as after:
        after.advance(0.6)
        request = after.take(CancelNavigation)[-1]
        assert request.client == "module"
        after.reply(request, NavigationCancelled())
        after.advance(2.0)
        assert not after.take(CancelNavigation)


def test_panel_hears_that_goals_are_welcome(nav2: Harness) -> None:
    assert nav2.call(IsNavigationActive())
