"""Services of the bridge, called by a plain session of Zenoh and by a process with CycloneDDS's own types."""

import json
import logging
import os
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from robbie_mp import ModuleHarness, Reply, Request, SettingError
from robbie_mp.connect.bridge.arrivals import hand_over
from robbie_mp.connect.bridge.mapping import Incoming, Quality
from robbie_mp.connect.bridge.orders import carry_out, orders_of
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.service_types import SET_BOOL as SET_BOOL_TYPE
from robbie_mp.connect.ros2.service_types import TRIGGER as TRIGGER_TYPE
from robbie_mp.messages import (
    CallsAnswer,
    CallsQuestion,
    CancelNavigation,
    ControlState,
    EmergencyStop,
    Message,
    NavigateTo,
    NavigationCancelled,
    PoseStamped,
    SetControl,
)
from robbie_mp.messages.descriptions import KnownTypes
from robbie_mp.module.calls.peers import service_topic
from tests._support.places import PROJECT
from tests._support.robot import wait_until
from tests.connect.ros2.test_zenoh import SET_BOOL, TRIGGER, Bridge, Node, network, until, zenoh_has_started

__all__ = ["zenoh_has_started"]
DOMAIN = 100 + os.getpid() % 80
ORDERS = {
    "services": {
        "/abort": "CancelNavigation {reason: from ROS}",
        "/go": "CancelNavigation {client: go} or {client: halt}",
    },
    "emergency_stop": "release",
}
LOADED = b"\x00\x01\x00\x00\x01\x00\x00\x00\x06\x00\x00\x00hello\x00"
"""A response of SetBool."""
EMPTY = b"\x00\x01\x00\x00\x00"
"""A request without fields: ROS puts one byte into it."""


Ros = tuple[Bridge, Node]


@pytest.fixture(scope="module")
def ros(zenoh_has_started: None) -> Iterator[Ros]:
    """A bridge with services, a router and a node."""
    with network(ORDERS) as both:
        yield both


def as_bool(value: bool) -> bytes:
    return b"\x00\x01\x00\x00" + bytes([value])


def read(reply: Any) -> tuple[bool, str]:
    """Read success and message from a response, as CDR lays them out."""
    data = reply.ok.payload.to_bytes()
    assert data[:4] == b"\x00\x01\x00\x00"
    (length,) = struct.unpack_from("<I", data, 8)
    return bool(data[4]), data[12 : 12 + length - 1].decode()


def asked_of_the_robot(bridge: Bridge) -> list[Any]:
    """Return the requests that the bridge has sent to modules of the robot."""
    name = CancelNavigation.type_name
    return [one.message for one in bridge.published if one.message.type_name == name]


def test_services_have_the_hashes_that_ros_has_published() -> None:
    assert SET_BOOL.endswith(SET_BOOL_TYPE.type_hash)
    assert TRIGGER.endswith(TRIGGER_TYPE.type_hash)


def test_node_calls_services_of_the_robot(ros: Ros) -> None:
    bridge, node = ros
    asked = node.ask(f"7/abort/{TRIGGER}", EMPTY, number=41)
    until(bridge, lambda: asked_of_the_robot(bridge))
    (request,) = asked_of_the_robot(bridge)
    assert request.reason == "from ROS"
    bridge.reply(request, NavigationCancelled(client="mission"))
    bridge.advance(0.02)
    reply = asked.recv()
    assert read(reply) == (True, '{"client": "mission"}')
    number, sent_ns, length, client = struct.unpack("<qqB16s", reply.ok.attachment.to_bytes())
    assert (number, length, client) == (41, 16, b"a client of ROS.")
    assert abs(time.time_ns() - sent_ns) < 60e9
    bridge.bus.published.clear()
    asked = node.ask(f"7/go/{SET_BOOL}", as_bool(False))
    until(bridge, lambda: asked_of_the_robot(bridge))
    (request,) = asked_of_the_robot(bridge)
    assert request.client == "halt"
    bridge.refuse(request, "there is no goal")
    bridge.advance(0.02)
    assert read(asked.recv()) == (False, "there is no goal")


def test_emergency_stop_is_answered_by_what_the_base_says(ros: Ros) -> None:
    bridge, node = ros
    engage = node.ask(f"7/emergency_stop/engage/{TRIGGER}", EMPTY)
    until(bridge, lambda: bridge.take(EmergencyStop, "emergency_stop"))
    bridge.advance(0.3)
    (repeated,) = bridge.take(EmergencyStop, "emergency_stop")
    assert repeated.engaged
    bridge.send(EmergencyStop(engaged=True), topic="emergency_stop_state")
    assert read(engage.recv()) == (True, "the robot stands still")
    release = node.ask(f"7/emergency_stop/{SET_BOOL}", as_bool(False))
    until(bridge, lambda: any(isinstance(one.message, EmergencyStop) for one in bridge.published))
    (released,) = bridge.take(EmergencyStop, "emergency_stop")
    assert not released.engaged
    bridge.advance(1.1)
    success, message = read(release.recv())
    assert not success
    assert "no base has confirmed it" in message


def test_release_is_offered_only_if_the_profile_says_so() -> None:
    alone = {"connect": [], "parameters": "none"}
    with ModuleHarness(Ros2Bridge, alone) as bridge:
        assert list(bridge.module.desk.offered) == ["/emergency_stop/engage"]
    with ModuleHarness(Ros2Bridge, {**alone, "emergency_stop": "none"}) as bridge:
        assert not bridge.module.desk.offered


def test_late_release_does_nothing() -> None:
    with ModuleHarness(Ros2Bridge, {"connect": [], "emergency_stop": "release"}) as bridge:
        answers: list[tuple[bool, str]] = []
        stop = bridge.module._stop
        assert stop is not None
        stop.release(0.6, lambda *answer: answers.append(answer))
        assert [success for success, _ in answers] == [False]
        assert not bridge.take(EmergencyStop)


LATE_ORDERS = {
    "/go_on": "SetControl {mode: 0}",
    "/hold": "SetControl {mode: 2}",
    "/abort": "SetControl {mode: 0} stops",
    "/pause": "SetControl stops or {mode: 0}",
    "/run": "SetControl {mode: 0} or {mode: 2}",
}


@pytest.mark.parametrize(
    ("name", "is_on", "is_given"),
    [
        ("/go_on", True, False),
        ("/hold", True, True),
        ("/abort", True, True),
        ("/pause", True, True),
        ("/run", False, True),
    ],
)
def test_late_order_to_move_does_nothing_and_one_to_stop_does(name: str, is_on: bool, is_given: bool) -> None:
    with ModuleHarness(Ros2Bridge, {"connect": [], "emergency_stop": "none"}) as bridge:
        bridge.advance(0.1)
        (order,) = (one for one in orders_of(LATE_ORDERS, KnownTypes()) if one.name == name)
        answers: list[tuple[bool, str]] = []
        carry_out(bridge.module, order, is_on, 10.0, lambda *answer: answers.append(answer))
        bridge.advance(0.1)
        assert (len(bridge.take(SetControl)), len(answers)) == ((1, 0) if is_given else (0, 1))


def test_late_goal_and_late_release_are_not_handed_over() -> None:
    goal = Incoming("/goal", PoseStamped.type_name, "", NavigateTo, Quality())
    stop = Incoming("/stop", EmergencyStop.type_name, "emergency_stop", None, Quality())
    released, engaged = EmergencyStop().encode(), EmergencyStop(engaged=True).encode()
    with ModuleHarness(Ros2Bridge, {"connect": [], "emergency_stop": "none"}) as bridge:
        bridge.advance(0.1)

        def is_taken(incoming: Incoming, kind: type[Message], data: bytes, waited_s: float) -> bool:
            return hand_over(bridge.module, incoming, kind, data, 0.3, waited_s)

        assert is_taken(goal, PoseStamped, PoseStamped().encode(), 0.1)
        assert not is_taken(goal, PoseStamped, PoseStamped().encode(), 10.0)
        assert is_taken(stop, EmergencyStop, released, 0.1)
        assert not is_taken(stop, EmergencyStop, released, 10.0)
        assert is_taken(stop, EmergencyStop, engaged, 10.0)


def test_goal_by_topic_is_refused_with_a_word_while_the_robot_may_not_drive_by_itself(
    caplog: pytest.LogCaptureFixture,
) -> None:
    settings = {"connect": [], "accept": {"/goal": "PoseStamped as NavigateTo", "/pose": "PoseStamped"}}
    with ModuleHarness(Ros2Bridge, settings) as bridge:
        channels = {one.name: one for one in bridge.module._incoming}

        def goals_taken(mode: int) -> int:
            bridge.send(ControlState(mode=mode, reason="somebody let go"), topic="control")
            for channel in channels.values():
                bridge.module.inbox.put(channel, PoseStamped().encode(), time.time_ns())
            bridge.advance(0.05)
            return len(bridge.take(NavigateTo))

        modes = (ControlState.HOLD, ControlState.MANUAL, ControlState.AUTO)
        assert [goals_taken(one) for one in modes] == [0, 0, 1]
        assert len(bridge.published_encoded) == 3  # a pose on another topic is no goal
        assert bridge.module.refused == 2
        assert "a goal on /goal is refused: the robot is in HOLD: somebody let go; order" in caplog.text
        assert "the robot is in MANUAL" in caplog.text


def test_wrong_requests_are_counted_and_reach_nobody(ros: Ros) -> None:
    bridge, node = ros
    bridge.bus.published.clear()
    wrong = node.ask(f"7/go/{SET_BOOL}", b"\x00\x01\x00\x00")
    bare = node.session.get(f"7/go/{SET_BOOL}", payload=as_bool(True), timeout=20.0)
    until(bridge, lambda: bridge.module.desk.malformed and bridge.module.inbox.strangers)
    assert not asked_of_the_robot(bridge)
    assert not list(wrong)
    assert not list(bare)


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("Cancel", "no module of this robot declares a service 'Cancel'"),
        ("CancelNavigation {speed: 1}", "speed"),
        ("NavigateTo", "is an action"),
        ("CancelNavigation a b c", "expected a service"),
    ],
)
def test_wrong_services_are_explained(line: str, problem: str) -> None:
    log = logging.getLogger("module")
    limits = [*log.filters]
    with pytest.raises(SettingError, match=problem):
        ModuleHarness(Ros2Bridge, {"connect": [], "services": {"/abort": line}}).__enter__()
    assert log.filters == limits, "a bridge that has not started limits no log"


class Loaded(Reply, name="std_srvs/srv/SetBool_Response"):
    success: bool
    message: str


class LoadMap(Request[Loaded], name="std_srvs/srv/SetBool_Request"):
    data: bool


CALLS = {"calls": {"/slam/load": "SetBool maps"}}


def ask_ros(bridge: Bridge, number: int) -> list[Any]:
    """Let a module call a service of ROS; return a list that the reply or refusal will come into."""
    bridge.bus.published.clear()
    bridge.send(LoadMap(call=number, data=True), topic=service_topic("maps"), sender="mission")
    return bridge.published


def test_module_calls_a_service_over_zenoh(zenoh_has_started: None) -> None:
    with network(CALLS) as (bridge, node):
        ends = ask_ros(bridge, 1)
        until(bridge, lambda: ends)
        assert "no node serves /slam/load" in ends[0].message.reason

        def respond(query: Any) -> None:
            attached = struct.unpack("<qqB16s", query.attachment.to_bytes())
            assert query.payload.to_bytes() == as_bool(True)
            answer = struct.pack("<qqB16s", attached[0], 1, 16, attached[3])
            query.reply(query.key_expr, LOADED, attachment=answer)

        key = f"7/slam/load/{SET_BOOL}"
        with node.session.declare_queryable(key, respond, complete=True):

            def has_replied() -> bool:
                ends = ask_ros(bridge, 2)
                until(bridge, lambda: ends)
                return getattr(ends[0].message, "message", "") == "hello"

            until(bridge, has_replied)
        until(bridge, lambda: any("/SC/" in one for one in node.tokens()))


def test_module_calls_a_service_of_a_node_with_cyclonedds() -> None:
    settings = {**CALLS, "middleware": "dds", "domain": DOMAIN + 1}
    with ModuleHarness(Ros2Bridge, settings) as bridge:
        command = [sys.executable, "-m", "tests.connect.ros2.dds_client", str(DOMAIN + 1), "/slam/load"]
        with subprocess.Popen(command, cwd=PROJECT) as server:

            def has_replied() -> bool:
                ends = ask_ros(bridge, 3)
                until(bridge, lambda: ends)
                reply = ends[0].message
                return (getattr(reply, "success", False), reply.call) == (True, 3)

            try:
                until(bridge, has_replied)
            finally:
                server.terminate()


def test_call_that_ros_has_not_answered_yet_is_not_lost() -> None:
    settings = {**CALLS, "middleware": "dds", "domain": DOMAIN + 2}
    with ModuleHarness(Ros2Bridge, settings) as bridge:
        ask_ros(bridge, 4)
        question = CallsQuestion(calls=np.array([4, 5], np.uint64))
        bridge.send(question, topic=bridge.module.name, sender="mission")
        (answer,) = bridge.take(CallsAnswer)
        assert list(answer.pending) == [4]


@pytest.mark.parametrize(
    ("calls", "problem"),
    [
        ({"/slam/load": "Nothing"}, "declares a service 'Nothing'"),
        ({"/1": "SetBool"}, "expected a name such as"),
    ],
)
def test_wrong_calls_are_explained(calls: dict[str, str], problem: str) -> None:
    with pytest.raises(SettingError, match=problem):
        ModuleHarness(Ros2Bridge, {"connect": [], "calls": calls}).__enter__()


def test_client_over_dds_gets_its_response() -> None:
    settings = {**ORDERS, "middleware": "dds", "domain": DOMAIN, "namespace": "team"}
    with ModuleHarness(Ros2Bridge, settings) as bridge:
        command = [sys.executable, "-m", "tests.connect.ros2.dds_client", str(DOMAIN)]
        with subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, text=True) as client:

            def has_ended() -> bool:
                for request in asked_of_the_robot(bridge):
                    bridge.reply(request, NavigationCancelled(client=f"{request.client}ed"))
                bridge.bus.published.clear()
                bridge.advance(0.02)
                return client.poll() is not None

            wait_until(has_ended, 30.0)
            told = json.loads(client.communicate()[0])
    begin = "serviceid="
    assert told["response"] == [0x1122334455667788, 5, True, '{"client": "halted"}']
    assert told["type"] == "std_srvs::srv::dds_::SetBool_Response_"
    assert told["user_data"].startswith(begin)
    end = "typehash=RIHS01_d0814e7f7b4880ab77e9c57426c7aa1562ab69f11eef8e2e968812f9cbd0b059;"
    assert told["user_data"].endswith(end)
    assert len(told["user_data"].removeprefix(begin).partition(";")[0].split(".")) == 16
