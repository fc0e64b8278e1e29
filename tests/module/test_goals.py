"""Goals, in the harness: each ends exactly once, with a result or an error."""

import pytest

from robbie_mp import (
    ActiveGoal,
    CallError,
    CallRefused,
    CallTimedOut,
    Feedback,
    Goal,
    GoalAborted,
    GoalCancelled,
    GoalPreempted,
    Module,
    ModuleHarness,
    Result,
    SentGoal,
    ServerDied,
    float64,
)
from robbie_mp.messages import CallRefusal, DeclarationError, GoalCancel, GoalEnd
from robbie_mp.messages.calls import goal_types
from robbie_mp.module.calls.errors import GoalEnded, WrongReply


class Driven(Feedback, name="test_goals/action/DriveTo_Feedback"):
    left_m: float64


class Arrived(Result, name="test_goals/action/DriveTo_Result"):
    duration_s: float64


class DriveTo(Goal[Driven, Arrived], name="test_goals/action/DriveTo_Goal"):
    x_m: float64


Active = ActiveGoal[DriveTo, Driven, Arrived]


class Wheels(Module):
    """Drives 1 m per tick; a new goal takes the place of the old one."""

    period_s = 1.0

    def setup(self) -> None:
        self.active: Active | None = None
        self.left_m = 0.0
        if self.restored is not None:
            self.active = self.resume_goal(DriveTo, self.restored)
            self.left_m = self.active.goal.x_m
        self.serve_goals(DriveTo, self.on_goal)

    def on_goal(self, active: Active) -> None:
        if active.goal.x_m < 0:
            raise CallRefused("the goal is inside a wall")
        if self.active is not None and self.active.is_active:
            self.active.preempt(f"{active.client} has another goal")
        self.active, self.left_m = active, active.goal.x_m
        self.checkpoint(active.memory)

    def tick(self) -> None:
        if self.active is None or not self.active.is_active:
            return
        self.left_m -= 1.0
        self.active.feedback(Driven(left_m=self.left_m))
        if self.left_m <= 0:
            self.active.succeed(Arrived(duration_s=self.active.goal.x_m))


class Driver(Module):
    """Sends goals when the test says so."""

    def setup(self) -> None:
        self.ends: list[Arrived | CallError] = []
        self.driven: list[float] = []

    def go(self, timeout_s: float | None = None) -> SentGoal:
        return self.send_goal(
            DriveTo(x_m=3.0),
            self.ends.append,
            self.ends.append,
            lambda driven: self.driven.append(driven.left_m),
            timeout_s=timeout_s,
        )


def test_types_of_an_action_are_found_and_checked() -> None:
    assert goal_types(DriveTo) == (Driven, Arrived)

    class Turn(Goal[Driven, Arrived], name="test_goals/action/Turn_Goal"):
        pass

    with pytest.raises(DeclarationError, match="Turn: its ROS names must be like test_goals"):
        goal_types(Turn)


def test_server_gives_feedback_and_a_result() -> None:
    with ModuleHarness(Wheels) as harness:
        harness.send_goal(DriveTo(x_m=2.0))
        harness.advance(5.0)
        assert harness.take(Driven) == [Driven(call=1, left_m=1.0), Driven(call=1, left_m=0.0)]
        assert harness.take(Arrived) == [Arrived(call=1, duration_s=2.0)]
        assert not harness.published


def test_server_refuses_cancels_and_preempts() -> None:
    with ModuleHarness(Wheels) as harness:
        harness.send_goal(DriveTo(x_m=-1.0))
        assert harness.take(CallRefusal) == [CallRefusal(call=1, reason="the goal is inside a wall")]
        first = harness.send_goal(DriveTo(x_m=9.0))
        second = harness.send_goal(DriveTo(x_m=9.0), client="operator")
        harness.cancel_goal(first)
        harness.cancel_goal(second, "enough", client="operator")
        harness.cancel_goal(second, "enough", client="operator")
        assert [(end.call, end.outcome, end.reason) for end in harness.take(GoalEnd)] == [
            (2, GoalEnd.PREEMPTED, "operator has another goal"),
            (3, GoalEnd.CANCELLED, "enough"),
        ]
        assert harness.module.active is not None
        assert not harness.module.active.is_active


def test_ended_goal_cannot_end_again() -> None:
    with ModuleHarness(Wheels) as harness:
        harness.send_goal(DriveTo(x_m=1.0))
        active = harness.module.active
        assert active is not None
        with pytest.raises(WrongReply, match="send a Driven"):
            active.feedback(Arrived(duration_s=1.0))  # type: ignore[arg-type]
        harness.advance(0.0)
        with pytest.raises(GoalEnded, match="this DriveTo of client has already ended"):
            active.abort("too late")


def test_preempting_a_goal_that_has_ended_does_nothing() -> None:
    with ModuleHarness(Wheels) as harness:
        harness.cancel_goal(harness.send_goal(DriveTo(x_m=9.0)), "enough")
        active = harness.module.active
        assert active is not None
        active.preempt("another one came")
        assert [end.outcome for end in harness.take(GoalEnd)] == [GoalEnd.CANCELLED]


def test_goal_with_the_number_of_one_that_has_not_ended_is_ignored() -> None:
    with ModuleHarness(Wheels) as harness:
        goal = harness.send_goal(DriveTo(x_m=9.0))
        first = harness.module.active
        channel = next(one.name for one in harness.bus.subscriptions if one.decoder is DriveTo)
        harness.bus.deliver(channel, goal.encode(), "client")
        assert harness.module.active is first
        assert first is not None
        assert first.is_active
        assert not harness.take(GoalEnd)


def test_goal_survives_a_restart_of_its_server() -> None:
    with ModuleHarness(Wheels) as harness:
        harness.send_goal(DriveTo(x_m=2.0))
        memory = harness.checkpoint
    with ModuleHarness(Wheels, restored=memory) as harness:
        harness.advance(5.0)
        assert harness.take(Arrived) == [Arrived(call=1, duration_s=2.0)]


def test_client_gets_feedback_and_the_result_once() -> None:
    with ModuleHarness(Driver) as harness:
        sent = harness.module.go()
        (goal,) = harness.take(DriveTo)
        harness.advance(100.0)
        harness.feed_back(goal, Driven(left_m=1.0))
        was_active = sent.is_active
        harness.end_goal(goal, Arrived(duration_s=2.0))
        harness.feed_back(goal, Driven(left_m=0.0))
        harness.end_goal(goal, GoalAborted("too late"))
        assert was_active > sent.is_active
        assert not sent.cancel()
        assert harness.module.driven == [1.0]
        assert harness.module.ends == [Arrived(call=goal.call, duration_s=2.0)]


@pytest.mark.parametrize(
    "error", [GoalAborted("no path"), GoalCancelled("by you"), GoalPreempted("by another")]
)
def test_client_gets_the_end_of_a_goal(error: CallError) -> None:
    with ModuleHarness(Driver) as harness:
        harness.module.go()
        (goal,) = harness.take(DriveTo)
        harness.end_goal(goal, error)
        (end,) = harness.module.ends
        assert (type(end), str(end)) == (type(error), str(error))


def test_cancel_asks_the_server_and_waits_for_its_answer() -> None:
    with ModuleHarness(Driver) as harness:
        sent = harness.module.go()
        assert sent.cancel("enough")
        (goal,), (cancel,) = harness.take(DriveTo), harness.take(GoalCancel)
        assert (cancel.call, cancel.reason) == (goal.call, "enough")
        assert sent.is_active
        harness.end_goal(goal, GoalCancelled(cancel.reason))
        assert isinstance(harness.module.ends[0], GoalCancelled)


def test_cancel_is_repeated_until_the_goal_has_ended() -> None:
    with ModuleHarness(Driver) as harness:
        sent = harness.module.go()
        (goal,) = harness.take(DriveTo)
        sent.cancel("enough")
        harness.take(GoalCancel)  # lost with the server's process
        harness.advance(0.3)
        assert [cancel.reason for cancel in harness.take(GoalCancel)] == ["enough"]
        harness.end_goal(goal, GoalCancelled("enough"))
        harness.advance(5.0)
        assert harness.take(GoalCancel) == []


def test_server_hears_of_a_repeated_cancel_once() -> None:
    class Braking(Wheels):
        def setup(self) -> None:
            super().setup()
            self.heard: list[str] = []
            self.serve_goals(DriveTo, self.on_goal, on_cancel=self.on_cancel, topic="braking")

        def on_cancel(self, _active: Active, reason: str) -> None:
            self.heard.append(reason)

    with ModuleHarness(Braking) as harness:
        goal = harness.send_goal(DriveTo(x_m=5.0), topic="braking")
        harness.cancel_goal(goal, "enough")
        harness.cancel_goal(goal, "enough")
        assert harness.module.heard == ["enough"]


def test_goal_that_takes_too_long_is_cancelled_until_it_has_ended() -> None:
    with ModuleHarness(Driver) as harness:
        sent = harness.module.go(timeout_s=2.0)
        (goal,) = harness.take(DriveTo)
        harness.advance(2.0)
        assert len(harness.take(GoalCancel)) == 1
        assert not sent.is_active
        assert not sent.cancel()
        harness.advance(0.3)
        assert [cancel.reason for cancel in harness.take(GoalCancel)] == ["its time is up"]
        harness.feed_back(goal, Driven(left_m=1.0))
        harness.end_goal(goal, Arrived(duration_s=2.0))
        harness.advance(5.0)
        assert harness.take(GoalCancel) == []
        assert [type(end) for end in harness.module.ends] == [CallTimedOut]
        assert harness.module.driven == []


def test_death_of_the_server_ends_the_goal() -> None:
    with ModuleHarness(Driver) as harness:
        harness.module.go()
        harness.advance(10.0)
        assert not harness.module.ends
        harness.kill_server()
        assert isinstance(harness.module.ends[0], ServerDied)
