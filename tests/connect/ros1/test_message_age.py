"""How old a message of ROS 1 can be, which nothing in it tells: its publisher says what it has sent."""

import math
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from robbie_mp.connect.ros1 import ros_node
from robbie_mp.connect.ros1.ros_node import ASK_IDLE_S, ASK_S, BUSY_S, _Origin
from tests._support.robot import wait_until
from tests.connect.ros1._support.ros import SYSTEM_PYTHON, needs_ros1
from tools.ros1.ros import Ros

ME, TOPIC, LINK = "/robbie", "/cmd_vel", 7
LIMIT_S = 10.0


class Publisher:
    """The XML-RPC server of a node that publishes velocities."""

    def __init__(self) -> None:
        self.sent = 0
        self.questions = 0
        self.is_roscpp = self.is_mute = False
        self.delay_s = 0.0
        self.server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
        self.server.register_function(lambda _name: self._info(), "getBusInfo")
        self.server.register_function(lambda _name: self._stats(), "getBusStats")
        threading.Thread(target=self.server.serve_forever, args=[0.02], daemon=True).start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()

    def _info(self) -> Any:
        links = [(LINK - 1, ME), (LINK - 1, "/other"), (LINK, ME)]  # its first one has ended
        return [1, "", [[number, name, "o", "TCPROS", TOPIC, True, ""] for number, name in links]]

    def _stats(self) -> Any:
        time.sleep(self.delay_s)
        self.questions += 1
        if self.is_mute:
            return [0, "not implemented", 0]
        if self.is_roscpp:
            return [[["/other", []], [TOPIC, [[LINK - 1, 0, 0, 900, 0], [LINK, 0, 0, self.sent, 0]]]], []]
        rows = [[LINK - 1, 0, 900, True], [LINK, 0, self.sent, True]]
        return [1, "", [[["/other", 0, []], [TOPIC, 0, rows]], [], []]]


@pytest.fixture
def publisher() -> Iterator[Publisher]:
    made = Publisher()
    yield made
    made.close()


class Transport:
    """The subscriber's end of a connection, as in rospy."""

    def __init__(self, uri: str, link: object):
        self.endpoint_id, self.socket = uri, link
        self.header = {"callerid": "/hand"}
        self.done = False

    def close(self) -> None:
        self.done = True


def connect(publisher: Publisher, link: object = None, lost: Callable[[], object] = list) -> _Origin:
    """Return a connection to a publisher. A test ends it with `transport.done`."""
    uri = f"http://127.0.0.1:{publisher.server.server_address[1]}"
    return _Origin(Transport(uri, link), TOPIC, ME, 0, lost)


@pytest.fixture
def origin(publisher: Publisher) -> Iterator[_Origin]:
    made = connect(publisher)
    yield made
    made._transport.done = True


def asked(publisher: Publisher, origin: _Origin) -> int:
    """Wait until a question that comes now has been answered; return the time before it, ns."""
    before_ns, questions = time.monotonic_ns(), publisher.questions
    wait_until(lambda: max(origin._asked_ns.values(), default=0) > before_ns, LIMIT_S)
    assert publisher.questions > questions
    return before_ns


@pytest.mark.parametrize("is_roscpp", [False, True])
def test_message_was_sent_after_the_last_question_whose_answer_did_not_count_it(
    publisher: Publisher, origin: _Origin, is_roscpp: bool
) -> None:
    publisher.is_roscpp = is_roscpp
    first_ns = asked(publisher, origin)
    publisher.sent += 2
    second_ns = asked(publisher, origin)
    after_ns = [origin.take(), origin.take()]
    assert all(first_ns < one < second_ns for one in after_ns)
    publisher.sent += 1
    assert origin.take() > second_ns


def test_messages_that_waited_on_their_way_are_as_old_as_they_are(
    publisher: Publisher, origin: _Origin
) -> None:
    asked(publisher, origin)
    publisher.sent = 20
    sent_ns = time.monotonic_ns()
    asked(publisher, origin)
    assert all(0 < origin.take() <= sent_ns for _ in range(20))
    assert origin.take() > sent_ns


@pytest.mark.parametrize(("latching", "is_known_again"), [("0", True), ("1", False)])
def test_first_message_is_no_older_than_its_connection_unless_its_publisher_kept_it(
    publisher: Publisher, monkeypatch: pytest.MonkeyPatch, latching: str, is_known_again: bool
) -> None:
    publisher.delay_s = 0.3
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    rospy = SimpleNamespace(get_name=lambda: ME, get_node_uri=lambda: "http://127.0.0.1:1")
    node = ros_node._Node(rospy, SimpleNamespace(), SimpleNamespace())  # type: ignore[arg-type]
    subscriber = SimpleNamespace(impl=SimpleNamespace(connections=[]), resolved_name=TOPIC)
    node._subscribers[1], node._looked_ns[1] = subscriber, time.monotonic_ns()
    for is_known in (True, is_known_again):
        before_ns = time.monotonic_ns()
        node._meet_publishers(1)  # nobody is there
        transport = connect(publisher)._transport
        transport.header = {"callerid": "/hand", "latching": latching}
        subscriber.impl.connections = [transport]
        sent_ns = node._sent_after_ns(1, transport.header)
        assert before_ns < sent_ns < time.monotonic_ns() if is_known else sent_ns == 0
        transport.done, subscriber.impl.connections = True, []


def test_age_of_a_message_is_not_known_before_the_publisher_has_answered(publisher: Publisher) -> None:
    publisher.delay_s = 0.5
    origin = connect(publisher)
    assert origin.take() == 0
    origin._transport.done = True


def test_message_of_a_node_that_does_not_count_has_an_age_only_on_this_machine(
    publisher: Publisher, origin: _Origin
) -> None:
    publisher.is_mute = True
    here = ("127.0.0.1", 1)
    near = connect(publisher, SimpleNamespace(getpeername=lambda: here, getsockname=lambda: here))
    far = connect(publisher, SimpleNamespace(getpeername=lambda: here, getsockname=lambda: ("10.0.0.2", 1)))
    wait_until(lambda: near._is_silent and far._is_silent, LIMIT_S)
    before_ns = time.monotonic_ns()
    assert near.take() > before_ns
    assert far.take() == 0
    near._transport.done = far._transport.done = True


def test_connection_that_has_lost_messages_is_replaced(
    publisher: Publisher, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_node, "MISSED_S", 0.1)
    monkeypatch.setattr(ros_node, "NEAR_S", math.inf)  # this machine may be busy
    lost = threading.Event()
    origin = connect(publisher, lost=lost.set)
    publisher.sent = 1
    assert lost.wait(LIMIT_S)
    assert not origin.is_open


def test_publisher_that_sends_nothing_is_asked_seldom(publisher: Publisher, origin: _Origin) -> None:
    assert ASK_S < ASK_IDLE_S
    origin.take()
    origin._received_s -= BUSY_S
    wait_until(lambda: not origin._sends.is_set(), LIMIT_S)
    origin.take()
    assert origin._sends.is_set()


PROGRAM = """
import os, sys, time, importlib.util
import rospy
spec = importlib.util.spec_from_file_location("ros_node", sys.argv[1])
ros_node = importlib.util.module_from_spec(spec)
spec.loader.exec_module(ros_node)
rospy.init_node("robbie", disable_signals=True)
ages, origins = [], {}

def take(message):
    (transport,) = [one for one in subscriber.impl.connections if one.header is message._connection_header]
    if transport not in origins:
        origins[transport] = ros_node._Origin(transport, sys.argv[2], "/robbie", 0, list)
    sent_ns = origins[transport].take()
    if sent_ns:
        ages.append((time.monotonic_ns() - sent_ns) / 1e9)

subscriber = rospy.Subscriber(sys.argv[2], rospy.AnyMsg, take, tcp_nodelay=True)
until_s = time.monotonic() + 20
while len(ages) < 20 and time.monotonic() < until_s:
    rospy.loginfo("still here")
    time.sleep(0.05)
print(len(ages), min(ages), flush=True)
os._exit(0)
"""


@needs_ros1
@pytest.mark.slow
@pytest.mark.parametrize("topic", ["/cmd_vel", "/rosout_agg"])
def test_nodes_of_rospy_and_of_roscpp_say_what_they_have_sent(topic: str, tmp_path: Path) -> None:
    with closing(Ros(tmp_path)) as ros, ExitStack() as stack:
        ros.start()
        stack.enter_context(ros.witness("numbers", {}, drives=True))
        command = [SYSTEM_PYTHON, "-c", PROGRAM, ros_node.__file__, topic]
        said = subprocess.run(
            command, env=ros.environment, capture_output=True, text=True, timeout=60, check=True
        )
    count, least_s = said.stdout.splitlines()[-1].split()
    assert int(count) >= 20
    assert 0 < float(least_s) < LIMIT_S
