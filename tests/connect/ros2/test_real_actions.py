"""Actions of the bridge over DDS beside real nodes of ROS 2; see `make ros`."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests._support.left_behind import leaving_nothing_behind
from tests._support.robot import COMMAND, Robot, kill, robot_in, wait_until
from tests.connect.ros2._support import fibonacci
from tests.connect.ros2._support.ros_nodes import DISTRIBUTIONS, RosNode, ros_node

pytestmark = pytest.mark.slow
DOMAIN = 60 + os.getpid() % 80
PROFILE = """
modules:
  rabbits: {{class: "zoo.fibonacci:Rabbits"}}
  ros2:
    class: "robbie_mp.connect.ros2.module:Ros2Bridge"
    settings:
      middleware: dds
      domain: {domain}
      actions: {{/fibonacci: Fibonacci}}
      calls: {{/node/fibonacci: Fibonacci ros}}
"""
CLIENT = """
import threading
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from test_msgs.action import Fibonacci
class Client(ActionClient):
    _lock = threading.Lock()  # rclpy 9.1 sets it after the threads that spin have seen the client
client = Client(node, Fibonacci, "/fibonacci")
is_there = client.wait_for_server(20.0)
class Sent:
    def __init__(self, order, **options):
        self.feedback, self.handle, self.end = [], None, None
        future = client.send_goal_async(Fibonacci.Goal(order=order), self.on_feedback, **options)
        future.add_done_callback(self.on_answer)
    def on_feedback(self, message):
        self.feedback.append(len(message.feedback.sequence))
    def on_answer(self, future):
        self.handle = future.result()
        if self.handle.accepted:
            self.handle.get_result_async().add_done_callback(self.on_end)
    def on_end(self, future):
        self.end = [future.result().status, list(future.result().result.sequence)]
    def told(self):
        is_accepted = self.handle.accepted if self.handle else None
        status = self.handle.status if is_accepted else 0
        return {"is_accepted": is_accepted, "status": status, "feedback": self.feedback, "end": self.end}
sent = {}
result = is_there
"""
SEND = "sent[name] = Sent(order)"
TOLD = "result = {name: one.told() for name, one in sent.items()}"
CANCEL = """
answer = sent[name].handle.cancel_goal_async()
"""
CANCELLED = (
    "result = [answer.result().return_code, len(answer.result().goals_canceling)] if answer.done() else None"
)
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


CANCEL_ALL = """
canceller = node.create_client(CancelGoal, "/fibonacci/_action/cancel_goal")
assert canceller.wait_for_service(10.0)
answer = canceller.call_async(CancelGoal.Request())
"""
SERVE = """
import time
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from test_msgs.action import Fibonacci
def execute(handle):
    numbers = [0, 1]
    while handle.request.order == 1000 or len(numbers) <= handle.request.order:
        time.sleep(0.05)
        if handle.is_cancel_requested:
            handle.canceled()
            return Fibonacci.Result()
        if handle.request.order == 13 and len(numbers) == 8:
            handle.abort()
            return Fibonacci.Result(sequence=[13])
        numbers.append((numbers[-1] + numbers[-2]) % 1000000)
        handle.publish_feedback(Fibonacci.Feedback(sequence=numbers[-20:]))
    handle.succeed()
    return Fibonacci.Result(sequence=numbers)
server = ActionServer(
    node, Fibonacci, "/node/fibonacci", execute, callback_group=ReentrantCallbackGroup(),
    goal_callback=lambda goal: GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT,
    cancel_callback=lambda handle: CancelResponse.ACCEPT,
)
"""


class Call:
    """`robbie call`, which sends a goal as a module does."""

    def __init__(self, robot: Robot, order: int):
        command = [*COMMAND, "call", "Fibonacci", f"{{order: {order}}}", "--topic", "ros", "--json"]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, cwd=robot.folder, stdout=pipe, stderr=pipe, text=True)

    def feedback(self) -> str:
        """Wait for feedback; return a line of it."""
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def cancel(self) -> None:
        self.process.send_signal(signal.SIGINT)

    def end(self) -> tuple[int, str, str]:
        """Wait for the end; return the exit code, the last line, and the error."""
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        with self.process.stdout as out, self.process.stderr as errors:
            *_, last = ["", *out]  # `communicate` would lose what a line has been read from
            error = errors.read()
        return self.process.wait(60), last, error


class Ros(NamedTuple):
    """A robot, and a real node beside it."""

    robot: Robot
    node: RosNode
    distribution: str
    domain: int

    def told(self, *names: str) -> list[dict[str, Any]]:
        """Return what the node knows of goals that it has sent."""
        told = self.node.run(TOLD)
        return [told[name] for name in names]

    def send(self, **orders: int) -> None:
        """Let the node send goals, by their names."""
        for name, order in orders.items():
            self.node.run(SEND, name=name, order=order)

    def wait_for_ends(self, *names: str) -> list[dict[str, Any]]:
        """Wait until goals have ended or were refused; return what the node knows of them."""
        wait_until(lambda: all(one["end"] or one["is_accepted"] is False for one in self.told(*names)), 30.0)
        return self.told(*names)

    def have_answers(self, *names: str) -> bool:
        """Return whether the node knows which of these goals were accepted."""
        return all(one["is_accepted"] is not None for one in self.told(*names))

    def wait_for_feedback(self, name: str) -> None:
        """Wait until the node has heard of the work on a goal."""
        wait_until(lambda: bool(self.told(name)[0]["feedback"]), 30.0)


@pytest.fixture
def call(ros: Ros) -> Iterator[Callable[[int], Call]]:
    """What sends goals; what has not ended at the end of a test is killed."""
    calls: list[Call] = []

    def begin(order: int) -> Call:
        calls.append(Call(ros.robot, order))
        return calls[-1]

    yield begin
    for one in calls:
        one.process.kill()
        one.process.wait()


@pytest.fixture
def nothing_left_behind() -> None:
    """The robot goes on between the tests; `ros` looks at the end."""


@pytest.fixture(scope="module", params=DISTRIBUTIONS)
def ros(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros]:
    domain = DOMAIN + DISTRIBUTIONS.index(request.param)
    with (
        leaving_nothing_behind(),
        ros_node(request.param, domain, tmp_path_factory.mktemp("ros")) as node,
        robot_in(tmp_path_factory.mktemp("robot")) as robot,
    ):
        (robot.folder / "zoo" / "fibonacci.py").write_text(Path(fibonacci.__file__).read_text())
        robot.write_profile(PROFILE.format(domain=domain))
        robot.start()
        robot.until(lambda figures: all(one["state"] == "RUNNING" for one in figures.values()))
        assert node.run(CLIENT)
        ros = Ros(robot, node, request.param, domain)
        ros.send(warm=fibonacci.ENDLESS)
        ros.wait_for_feedback("warm")
        node.run(CANCEL, name="warm")
        yield ros


def test_goal_of_a_node_is_accepted_and_reached_with_feedback(ros: Ros) -> None:
    ros.send(reached=8)
    ros.wait_for_feedback("reached")
    (told,) = ros.wait_for_ends("reached")
    assert told["end"] == [SUCCEEDED, [0, 1, 1, 2, 3, 5, 8, 13, 21]]
    assert set(told["feedback"]) <= set(range(3, 10))
    wait_until(lambda: ros.told("reached")[0]["status"] == SUCCEEDED, 10.0)


@pytest.mark.sampled(1)
def test_goal_that_the_module_refuses_is_not_accepted(ros: Ros) -> None:
    ros.send(refused=-1)
    (told,) = ros.wait_for_ends("refused")
    assert told["is_accepted"] is False


@pytest.mark.sampled(1)
def test_goal_that_the_module_gives_up_is_aborted(ros: Ros) -> None:
    ros.send(hopeless=fibonacci.HOPELESS)
    (told,) = ros.wait_for_ends("hopeless")
    assert told["end"] == [ABORTED, []]


def test_many_goals_run_at_once_and_one_of_them_is_cancelled(ros: Ros) -> None:
    ros.send(first=fibonacci.ENDLESS, second=fibonacci.ENDLESS, third=20, fourth=-1)
    ros.wait_for_feedback("first")
    ros.wait_for_feedback("second")
    ros.node.run(CANCEL, name="first")
    told = dict(zip(("first", "third", "fourth"), ros.wait_for_ends("first", "third", "fourth"), strict=True))
    assert ros.node.run(CANCELLED) == [0, 1]
    assert told["first"]["end"] == [CANCELED, []]
    assert told["third"]["end"][0] == SUCCEEDED
    assert told["fourth"]["is_accepted"] is False
    assert ros.told("second")[0]["end"] is None
    ros.node.run(CANCEL, name="second")
    assert ros.wait_for_ends("second")[0]["end"] == [CANCELED, []]


@pytest.mark.sampled(1)
def test_goal_is_aborted_when_its_module_dies_and_the_next_one_is_served(ros: Ros) -> None:
    ros.send(orphan=fibonacci.ENDLESS)
    ros.wait_for_feedback("orphan")
    kill(ros.robot.top()["rabbits"]["pid"])
    assert ros.wait_for_ends("orphan")[0]["end"] == [ABORTED, []]
    ros.send(next=5)
    assert ros.wait_for_ends("next")[0]["end"][0] == SUCCEEDED


@pytest.mark.sampled(1)
def test_goals_end_when_the_bridge_dies_and_the_next_bridge_serves(ros: Ros) -> None:
    ros.send(lost=fibonacci.ENDLESS)
    ros.wait_for_feedback("lost")
    kill(ros.robot.top()["ros2"]["pid"])
    ros.robot.until(lambda figures: figures["rabbits"]["status"] == "0 at work")
    wait_until(lambda: ros.told("lost")[0]["status"] == ABORTED, 30.0)

    def is_served_again() -> bool:  # what a node asks before it has found the new server is lost in ROS
        name = f"again{time.monotonic_ns()}"
        ros.send(**{name: 5})
        limit_s = time.monotonic() + 1.0
        while (told := ros.told(name)[0])["end"] is None and time.monotonic() < limit_s:
            pass
        return told["end"] is not None and told["end"][0] == SUCCEEDED

    wait_until(is_served_again, 30.0)


@pytest.mark.sampled(1)
def test_goal_of_a_node_that_dies_goes_on_until_another_node_cancels_all(ros: Ros, tmp_path: Path) -> None:
    with ros_node(ros.distribution, ros.domain, tmp_path) as other:
        assert other.run(CLIENT)
        other.run(SEND, name="widow", order=fibonacci.ENDLESS)
        ros.robot.until(lambda figures: figures["rabbits"]["status"] == "1 at work")
        other.kill()
    ros.node.run(CANCEL_ALL)
    wait_until(lambda: ros.node.run(CANCELLED) is not None, 10.0)
    assert ros.node.run(CANCELLED) == [0, 1]
    ros.robot.until(lambda figures: figures["rabbits"]["status"] == "0 at work")


@pytest.mark.sampled(1)
def test_too_many_goals_are_refused_and_counted(ros: Ros) -> None:
    is_accepted: list[bool] = []
    for number in range(9):  # a client keeps ten responses
        names = [f"many{number}_{index}" for index in range(8)]
        ros.send(**dict.fromkeys(names, fibonacci.ENDLESS))
        wait_until(partial(ros.have_answers, *names), 30.0)
        is_accepted += [one["is_accepted"] for one in ros.told(*names)]
    assert is_accepted == [True] * 64 + [False] * 8
    assert (
        "8 goals refused"
        in ros.robot.until(lambda figures: "refused" in figures["ros2"]["status"])["ros2"]["status"]
    )
    ros.node.run(CANCEL_ALL)
    ros.robot.until(lambda figures: figures["rabbits"]["status"] == "0 at work")


def test_module_sends_goals_to_a_node(ros: Ros, call: Callable[[int], Call]) -> None:
    assert "no node serves" in call(8).end()[2]
    ros.node.run(SERVE)
    code, line, _ = call(8).end()
    assert code == 0
    assert len(json.loads(line)["sequence"]) == 9
    code, _, error = call(-1).end()
    assert (code, "has refused the goal" in error) == (1, True)
    code, _, error = call(13).end()
    assert (code, "has aborted the goal: {'sequence': array([13]" in error) == (1, True)
    first, second = call(1000), call(1000)
    assert "sequence" in first.feedback()
    assert "sequence" in second.feedback()
    first.cancel()
    assert "Ctrl-C" in first.end()[2]
    second.cancel()
    second.end()


@pytest.mark.sampled(1)
def test_node_that_is_killed_ends_its_goals_and_the_next_node_serves(
    ros: Ros, tmp_path: Path, call: Callable[[int], Call]
) -> None:
    with ros_node(ros.distribution, ros.domain, tmp_path) as other:
        ros.node.run("if 'server' in globals(): server.destroy()")
        other.run(SERVE)
        wait_until(lambda: call(4).end()[0] == 0, 30.0)
        goal = call(1000)
        goal.feedback()
        other.kill()
    with ros_node(ros.distribution, ros.domain, tmp_path) as other:
        other.run(SERVE)
        wait_until(lambda: call(4).end()[0] == 0, 30.0)
        assert "has gone" in goal.end()[2]
