"""Goals between ROS and modules, without a node: what it asks is put into the inbox, or comes over Zenoh."""

import re
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np
import pytest

from robbie_mp import GoalAborted, GoalCancelled, ModuleHarness, SettingError
from robbie_mp.bus.transport.blocks import MessageTooLarge
from robbie_mp.connect.ros2 import goal_desk
from robbie_mp.connect.ros2.action_types import (
    ABORTED,
    CANCEL_GOAL,
    CANCELED,
    CANCELS,
    HAS_ENDED,
    STATUSES,
    SUCCEEDED,
    UNKNOWN,
    UNKNOWN_GOAL,
    action_type,
)
from robbie_mp.connect.ros2.goal_desk import MAX_GOALS, MAX_KEPT, MAX_WAITING, uuid_fields
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.service_types import ServiceType, ros_type
from robbie_mp.connect.ros2.side import RosChannel
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages import (
    CallRefusal,
    GoalCancel,
    GoalEnd,
    Header,
    Message,
    PoseStamped,
    as_dict,
    from_dict,
)
from robbie_mp.messages.stock.nav2_msgs import NavigatedToPose, NavigateToPose, NavigatingToPose
from tests._support.robot import wait_until
from tests.connect.ros2._support.fibonacci import Fibonacci, Grown, Sequence
from tests.connect.ros2.test_type_hash import PUBLISHED
from tests.connect.ros2.test_zenoh import free_port, until, zenoh_has_started

__all__ = ["zenoh_has_started"]
SETTINGS: dict[str, Any] = {
    "connect": [],
    "actions": {"/navigate_to_pose": "NavigateToPose", "/fibonacci": "Fibonacci rabbits"},
    "calls": {"/node/fibonacci": "test_msgs/action/Fibonacci ros"},
    "frames": {"map": "red/map"},
    "parameters": "none",
}
FIBONACCI = action_type(
    "test_msgs/action/Fibonacci", ros_type(Fibonacci), ros_type(Grown), ros_type(Sequence)
)
TO_POSE = action_type(
    "nav2_msgs/action/NavigateToPose",
    ros_type(NavigateToPose),
    ros_type(NavigatingToPose),
    ros_type(NavigatedToPose),
)


FIBONACCI_ONLY = {"parameters": "none", "emergency_stop": "none", "rosout": False}


class Ros:
    """A bridge, and what a node of ROS asks it and hears from it."""

    def __init__(self, bridge: ModuleHarness[Ros2Bridge]):
        self.bridge = bridge
        self.heard: list[tuple[str, Message]] = []
        self.age_s = 0.0
        """Of the requests."""
        side: Any = bridge.module.side
        side.send = self._hear

    def _hear(self, channel: RosChannel, data: bytes) -> None:
        kinds = {"status": STATUSES, "feedback": TO_POSE.feedback}
        self.heard.append((channel.name, kinds[channel.name.rpartition("/")[2]].decode(bytes(data))))

    def ask(self, name: str, service: ServiceType, **fields: object) -> list[Any]:
        """Send a request; return a list that the response will come into."""
        answers: list[Any] = []
        data = from_dict(service.request, fields).encode()
        sent_ns = time.time_ns() - round(self.age_s * 1e9)
        self.bridge.module.inbox.put_call(
            name, data, lambda data: answers.append(service.response.decode(data)), sent_ns
        )
        self.bridge.advance(0.02)
        return answers

    def send_goal(self, goal_id: bytes = b"", **fields: object) -> tuple[bytes, list[Any]]:
        """Send a goal; return its number, and a list that the answer will come into."""
        goal_id = goal_id or uuid4().bytes
        name = "/navigate_to_pose/_action/send_goal"
        return goal_id, self.ask(name, TO_POSE.send_goal, goal_id=uuid_fields(goal_id), goal=fields)

    def result_of(self, goal_id: bytes) -> list[Any]:
        name = "/navigate_to_pose/_action/get_result"
        return self.ask(name, TO_POSE.get_result, goal_id=uuid_fields(goal_id))

    def cancel(self, goal_id: bytes = bytes(16), stamp: Message | None = None) -> Any:
        """Cancel; return the code, and the numbers of the goals."""
        info = {"goal_id": uuid_fields(goal_id), **({"stamp": as_dict(stamp)} if stamp else {})}
        (answer,) = self.ask("/navigate_to_pose/_action/cancel_goal", CANCEL_GOAL, goal_info=info)
        return answer.return_code, [bytes(one.goal_id.uuid) for one in answer.goals_canceling]

    def sent(self) -> Any:
        """Return the goal that the module has got since this was called last."""
        (found,) = self.all_sent()
        return found

    def all_sent(self) -> list[Any]:
        goals = [one.message for one in self.bridge.published if one.message.type_name.endswith("_Goal")]
        self.bridge.bus.published.clear()
        return goals

    def states(self) -> list[int]:
        """Return the states of all goals as ROS has heard them last."""
        told: Any = [one for name, one in self.heard if name == "/navigate_to_pose/_action/status"][-1]
        return [one.status for one in told.status_list]


@pytest.fixture
def ros(zenoh_has_started: None) -> Iterator[Ros]:
    with ModuleHarness(Ros2Bridge, SETTINGS) as bridge:
        bridge.advance(0.0)
        yield Ros(bridge)


@pytest.mark.parametrize(("age_s", "why"), [(3.0, r"was sent [3-9]\.\d s ago"), (-2.0, "from the future")])
def test_goal_that_was_sent_long_ago_or_in_the_future_is_refused(
    ros: Ros, caplog: pytest.LogCaptureFixture, age_s: float, why: str
) -> None:
    ros.age_s = age_s
    _, (answer,) = ros.send_goal()
    assert not answer.accepted
    assert not ros.all_sent()
    assert re.search(why, caplog.text)


def test_types_of_actions_have_the_hashes_of_ros() -> None:
    computed = {one.name: one.type_hash for one in (FIBONACCI.send_goal, FIBONACCI.get_result, CANCEL_GOAL)}
    computed |= {one.type_name: type_hash(one) for one in (FIBONACCI.feedback, STATUSES)}
    assert computed == {name: PUBLISHED[name] for name in computed}


def goal_in(frame: str) -> dict[str, Any]:
    return {"pose": as_dict(PoseStamped(header=Header(frame_id=frame)))}


def test_goal_reaches_the_module_and_its_end_reaches_ros_with_other_frames(ros: Ros) -> None:
    goal_id, accepted = ros.send_goal(**goal_in("red/map"))
    assert [one.accepted for one in accepted] == [True]
    goal = ros.sent()
    assert goal.pose.header.frame_id == "map"
    waiting = ros.result_of(goal_id)
    assert not waiting
    there = PoseStamped(header=Header(frame_id="map"))
    ros.bridge.feed_back(goal, NavigatingToPose(current_pose=there, distance_remaining=2.0))
    told: Any = ros.heard[-1][1]
    assert bytes(told.goal_id.uuid) == goal_id
    assert told.feedback.current_pose.header.frame_id == "red/map"
    ros.bridge.end_goal(goal, NavigatedToPose())
    assert [one.status for one in (*waiting, *ros.result_of(goal_id))] == [SUCCEEDED, SUCCEEDED]
    assert ros.states() == [SUCCEEDED]


def test_goal_in_a_frame_of_another_robot_is_refused(ros: Ros) -> None:
    _, answers = ros.send_goal(**goal_in("map"))
    assert [one.accepted for one in answers] == [False]
    assert not ros.all_sent()
    assert ros.bridge.module.goal_desk.refused == 1


def test_goal_without_a_server_is_refused(ros: Ros) -> None:
    ros.bridge.remove_server()
    _, answers = ros.send_goal()
    ros.bridge.advance(0.1)
    assert [one.accepted for one in answers] == [False]


def test_reason_of_a_goal_that_was_not_reached_is_in_its_result(ros: Ros) -> None:
    goal_id, _ = ros.send_goal()
    ros.bridge.end_goal(ros.sent(), GoalAborted("no path"))
    (answer,) = ros.result_of(goal_id)
    assert (answer.status, answer.result.error_msg) == (ABORTED, "no path")


def test_dead_module_is_the_end_of_its_goals(ros: Ros) -> None:
    goal_id, _ = ros.send_goal()
    ros.bridge.kill_server()
    assert "died" in ros.result_of(goal_id)[0].result.error_msg


def test_goal_that_its_module_does_not_accept_in_time_is_refused_and_cancelled(
    ros: Ros, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goal_desk, "ACCEPT_WITHIN_S", 0.0)
    goal_id, answers = ros.send_goal()
    assert [one.accepted for one in answers] == [False]
    assert ros.bridge.take(GoalCancel)
    ros.bridge.end_goal(ros.sent(), GoalCancelled("too late"))
    assert ros.result_of(goal_id)[0].status == UNKNOWN


def test_number_that_was_used_is_refused(ros: Ros) -> None:
    goal_id, _ = ros.send_goal()
    _, answers = ros.send_goal(goal_id)
    assert [one.accepted for one in answers] == [False]
    assert len(ros.all_sent()) == 1


def test_goals_are_cancelled_one_by_one_until_a_time_or_all(ros: Ros) -> None:
    numbers, goals, stamps = [], [], []
    for _ in range(4):
        goal_id, (answer,) = ros.send_goal()
        numbers.append(goal_id)
        stamps.append(answer.stamp)
        goals.append(ros.sent())
        ros.bridge.advance(1.0)
    assert ros.cancel(numbers[3]) == (CANCELS, [numbers[3]])
    assert ros.bridge.take(GoalCancel)[0].call == goals[3].call
    ros.bridge.end_goal(goals[3], GoalCancelled("enough"))
    assert ros.result_of(numbers[3])[0].status == CANCELED
    assert ros.cancel(numbers[3]) == (HAS_ENDED, [])
    assert ros.cancel(uuid4().bytes) == (UNKNOWN_GOAL, [])
    assert ros.cancel(stamp=stamps[1]) == (CANCELS, numbers[:2])
    assert ros.cancel() == (CANCELS, numbers[:3])


def test_result_of_a_goal_that_nobody_knows_is_answered(ros: Ros) -> None:
    assert [one.status for one in ros.result_of(uuid4().bytes)] == [UNKNOWN]


def test_hostile_numbers_of_goals_and_questions_are_bounded_and_answered(ros: Ros) -> None:
    answers = [ros.send_goal() for _ in range(MAX_GOALS + 10)]
    assert sum(one.accepted for _, (one,) in answers) == MAX_GOALS
    assert ros.bridge.module.goal_desk.refused == 10
    waiting = [ros.result_of(answers[0][0]) for _ in range(MAX_WAITING + 3)]
    assert sum(map(len, waiting)) == 3
    for goal in ros.all_sent():
        ros.bridge.end_goal(goal, NavigatedToPose())
    assert sum(map(len, waiting)) == MAX_WAITING + 3
    for _ in range(10):
        ros.send_goal()
        ros.bridge.end_goal(ros.sent(), NavigatedToPose())
    assert len(ros.states()) == MAX_KEPT


def test_goals_of_a_bridge_that_died_are_cancelled_and_told_as_aborted(ros: Ros) -> None:
    goal_id, _ = ros.send_goal()
    goal = ros.sent()
    with ModuleHarness(Ros2Bridge, SETTINGS, restored=ros.bridge.checkpoint) as bridge:
        after = Ros(bridge)
        bridge.bus.peers.kept.add(goal.call)
        bridge.advance(0.02)
        assert {one.call for one in bridge.take(GoalCancel)} == {goal.call}
        assert after.states() == [ABORTED]
        assert after.result_of(goal_id)[0].status == ABORTED
        bridge.advance(1.0)
        assert bridge.take(GoalCancel), "it is cancelled until its module has ended it"
        bridge.end_goal(goal, GoalCancelled("the bridge has died"))
        bridge.advance(0.02)
        bridge.take(GoalCancel)
        bridge.advance(2.0)
        assert not bridge.take(GoalCancel)


def test_action_of_a_service_is_a_mistake_that_is_named() -> None:
    with (
        pytest.raises(SettingError, match="CancelNavigation is a service"),
        ModuleHarness(Ros2Bridge, {**SETTINGS, "actions": {"/x": "CancelNavigation"}}),
    ):
        pass


class Two(NamedTuple):
    """A bridge that offers an action of its robot, and one whose robot sends goals to it."""

    server: ModuleHarness[Ros2Bridge]
    client: ModuleHarness[Ros2Bridge]

    def until(self, condition: Callable[[], object]) -> None:
        def is_true() -> bool:
            self.server.advance(0.02)
            self.client.advance(0.02)
            return bool(condition())

        wait_until(is_true, 30.0)

    def send(self, order: int) -> Any:
        """Send a goal; return it, and what the server's module gets; None if it was refused."""
        self.client.bus.published.clear()
        sent = self.client.send_goal(Fibonacci(order=order), topic="ros")
        self.until(lambda: self.goals() or self.ends())
        return (sent, self.goals()[-1]) if self.goals() else None

    def goals(self) -> list[Any]:
        return [one.message for one in self.server.published if one.message.type_name == Fibonacci.type_name]

    def ends(self) -> list[Any]:
        """Return what the client's module has heard."""
        return [one.message for one in self.client.published if one.topic == "client"]


@pytest.fixture
def two(zenoh_has_started: None) -> Iterator[Two]:
    port = free_port()
    serving = {"actions": {"/fibonacci": "Fibonacci"}, "connect": [], "listen": [f"tcp/127.0.0.1:{port}"]}
    asking = {"calls": {"/fibonacci": "Fibonacci ros"}, "connect": [f"tcp/127.0.0.1:{port}"]}
    with (
        ModuleHarness(Ros2Bridge, {**FIBONACCI_ONLY, **serving}) as server,
        ModuleHarness(Ros2Bridge, {**FIBONACCI_ONLY, **asking}) as client,
    ):
        both = Two(server, client)
        both.until(lambda: both.send(0))
        server.bus.published.clear()
        yield both


def test_goal_of_a_module_reaches_a_server_and_comes_back_over_zenoh(two: Two) -> None:
    _, goal = two.send(5)

    def is_fed_back() -> bool:  # a publisher may meet its subscriber later than a service its client
        two.server.feed_back(goal, Grown(sequence=np.array([0, 1], np.int32)))
        return bool(two.ends())

    two.until(is_fed_back)
    assert two.ends()[0].sequence.tolist() == [0, 1]
    two.server.end_goal(goal, Sequence(sequence=np.array([5], np.int32)))
    two.until(lambda: two.ends()[-1].type_name == Sequence.type_name)
    assert two.ends()[-1].sequence.tolist() == [5]


def test_goal_over_zenoh_is_aborted_or_cancelled_for_its_module(two: Two) -> None:
    two.server.end_goal(two.send(5)[1], GoalAborted("bad luck"))
    two.until(two.ends)
    assert two.ends()[0].outcome == GoalEnd.ABORTED
    two.server.bus.published.clear()
    sent, goal = two.send(6)
    two.client.cancel_goal(sent, "enough")
    two.until(lambda: two.server.take(GoalCancel))
    two.server.end_goal(goal, GoalCancelled("enough"))
    two.until(two.ends)
    assert (two.ends()[0].outcome, two.ends()[0].reason) == (GoalEnd.CANCELLED, "enough")


def test_large_results_of_a_node_end_the_goal_and_not_the_bridge(ros: Ros) -> None:
    module: Any = ros.bridge.module
    results = [(SUCCEEDED, np.zeros(200_000, np.int32)), (ABORTED, np.zeros(900, np.int32))]
    publish = module.ros_goals._module._bus.publish

    def publish_small(message: Message, topic: str, latched: bool = False) -> bool:
        if message.type_name == Sequence.type_name:
            raise MessageTooLarge("it does not fit into this module's memory")
        return bool(publish(message, topic, latched))

    def call(name: str, _: bytes, done: Callable[[bytes], None], limit_s: float = 0.0) -> None:
        if name.endswith("send_goal"):
            answer = from_dict(FIBONACCI.send_goal.response, {"accepted": True})
        else:
            status, sequence = results.pop(0)
            fields = {"status": status, "result": {"sequence": sequence}}
            answer = from_dict(FIBONACCI.get_result.response, fields)
        done(answer.encode())

    module.side.call = call
    module.ros_goals._module._bus.publish = publish_small
    for reason in ("does not fit", "has aborted"):
        ros.bridge.send_goal(Fibonacci(order=1), topic="ros")
        until(ros.bridge, lambda: any(isinstance(one.message, GoalEnd) for one in ros.bridge.published))
        (end,) = ros.bridge.take(GoalEnd)
        assert reason in end.reason
        assert len(end.reason) < 1100
    assert not module.ros_goals.memory


def test_goal_for_a_node_that_is_not_there_is_refused(ros: Ros) -> None:
    ros.bridge.send_goal(Fibonacci(order=1), topic="ros")
    until(ros.bridge, lambda: ros.bridge.take(CallRefusal))
