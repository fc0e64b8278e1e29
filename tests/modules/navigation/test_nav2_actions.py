"""Nav2's actions, which become goals of navigation."""

from collections.abc import Iterator

import pytest

from robbie_mp import GoalAborted, GoalCancelled, GoalPreempted, ModuleHarness
from robbie_mp.messages import (
    CallRefusal,
    CancelNavigation,
    ControlState,
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
    NavigatedThroughPoses,
    NavigatedToPose,
    NavigateThroughPoses,
    NavigateToPose,
    NavigatingThroughPoses,
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


def test_poses_are_driven_through_and_the_feedback_tells_how_far_the_last_one_is(nav2: Harness) -> None:
    nav2.send_goal(NavigateThroughPoses(poses=[at(1.0), at(3.0), at(2.5)]))
    told = []
    for x_m in (1.0, 3.0, 2.5):
        goal = driven_to(nav2)
        assert goal.pose == at(x_m)
        nav2.feed_back(goal, NavigationFeedback(state="DRIVE", distance_left_m=0.25))
        told += nav2.take(NavigatingThroughPoses)
        assert not nav2.take(NavigatedThroughPoses)
        nav2.end_goal(goal, NavigationResult())
    assert [(one.number_of_poses_remaining, one.distance_remaining) for one in told] == [
        (3, 2.75),
        (2, 0.75),
        (1, 0.25),
    ]
    assert nav2.take(NavigatedThroughPoses)
    assert nav2.checkpoint is None


def test_pose_that_cannot_be_reached_ends_the_way_through_others(nav2: Harness) -> None:
    nav2.send_goal(NavigateThroughPoses(poses=[at(1.0), at(2.0)]))
    nav2.end_goal(driven_to(nav2), GoalAborted("a wall"))
    assert nav2.take(GoalEnd)[0].reason == "a wall"
    assert not nav2.take(NavigateTo)


def test_goal_is_refused_while_modules_may_not_drive(nav2: Harness) -> None:
    """It moved the robot as soon as an operator, who knew nothing of it, let the robot go on."""
    nav2.send(ControlState(mode=ControlState.HOLD, reason="the stop was released"), topic="control")
    nav2.send_goal(NavigateToPose(pose=at(2.5)))
    assert "(the stop was released); order it to go on" in nav2.take(CallRefusal)[0].reason
    nav2.send(ControlState(mode=ControlState.AUTO), topic="control")
    assert not nav2.take(NavigateTo)
    nav2.send_goal(NavigateToPose(pose=at(2.5)))
    assert driven_to(nav2).pose == at(2.5)


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


def test_goals_without_a_first_pose_are_refused(nav2: Harness) -> None:
    nav2.send_goal(FollowWaypoints(poses=[at(1.0)], goal_index=1))
    assert "there is no waypoint 1" in nav2.take(CallRefusal)[0].reason
    nav2.send_goal(NavigateThroughPoses())
    assert "the goal has 0 poses" in nav2.take(CallRefusal)[0].reason


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
