"""The bridge beside real nodes of which it deals with some only; see `make ros`."""

import os
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from robbie_mp import ModuleHarness, Reply, Request
from robbie_mp.connect.ros2.dds_side import DdsSide
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.nodes import Admission
from robbie_mp.messages import CancelNavigation, NavigationCancelled
from robbie_mp.module.calls.peers import service_topic
from tests.connect.ros2._support.ros_nodes import DISTRIBUTIONS, RosNode, ros_node, until

pytestmark = [pytest.mark.slow, pytest.mark.every_turn]
DOMAIN = 60 + os.getpid() % 80
SETTINGS: dict[str, Any] = {
    "middleware": "dds",
    "nodes": ["/slam/*", "/tester"],
    "accept": {"/text": "String text latched", "/words": "String words"},
    "services": {"/abort": "CancelNavigation"},
    "calls": {"/save": "std_srvs/srv/Trigger"},
}
PUBLISH_LATCHED = """
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
context = rclpy.Context()
rclpy.init(context=context, domain_id=domain)
intruder = rclpy.create_node("intruder", context=context)
publishers = {}
for name, one in (("tester", node), ("intruder", intruder)):
    text = one.create_publisher(String, "/text", latched)
    text.publish(String(data=name))
    publishers[name] = one.create_publisher(String, "/words", 10), text
"""
SPEAK = "for name, (one, _) in publishers.items(): one.publish(String(data=name))"
CALL = """
abort, wrong = node.create_client(Trigger, "/abort"), intruder.create_client(Trigger, "/abort")
assert abort.wait_for_service(20.0)
result = wrong.wait_for_service(1.0)
answer = abort.call_async(Trigger.Request())
"""
SERVE = """
def save(request, response):
    response.success, response.message = True, "saved"
    return response
serving = {who}.create_service(Trigger, "/save", save)
"""
SPIN = """
import threading
from rclpy.executors import SingleThreadedExecutor
executor_of_intruder = SingleThreadedExecutor(context=context)
executor_of_intruder.add_node(intruder)
spinning = threading.Thread(target=executor_of_intruder.spin, daemon=True)
spinning.start()
"""
END = """
executor_of_intruder.shutdown(1.0)
spinning.join()
intruder.destroy_node()
rclpy.shutdown(context=context)
"""


class Saved(Reply, name="std_srvs/srv/Trigger_Response"):
    success: bool
    message: str


class SaveMap(Request[Saved], name="std_srvs/srv/Trigger_Request"):
    pass


class Ros(NamedTuple):
    """A bridge, and a process with a node that it deals with and one that it does not."""

    bridge: ModuleHarness[Ros2Bridge]
    node: RosNode


@pytest.fixture(scope="module", params=DISTRIBUTIONS)
def ros(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros]:
    domain = DOMAIN + DISTRIBUTIONS.index(request.param)
    with ros_node(request.param, domain, tmp_path_factory.mktemp("ros")) as node:
        node.run(PUBLISH_LATCHED, domain=domain)
        node.run(SPIN)
        with ModuleHarness(Ros2Bridge, {**SETTINGS, "domain": domain}) as bridge:
            yield Ros(bridge, node)
        node.run(END)


def texts(bridge: ModuleHarness[Ros2Bridge], topic: str) -> list[bytes]:
    return [bytes(one.data) for one in bridge.published_encoded if one.topic == topic]


def test_messages_of_other_nodes_are_refused_and_latched_ones_wait_until_their_node_is_known(
    ros: Ros, caplog: pytest.LogCaptureFixture
) -> None:
    bridge, node = ros
    until(bridge, lambda: texts(bridge, "text"))

    def are_all_heard() -> bool:
        node.run(SPEAK)
        is_named = "a message on /words of /intruder is refused: see `nodes`" in caplog.text
        return bool(texts(bridge, "words")) and is_named

    until(bridge, are_all_heard)
    heard = texts(bridge, "words") + texts(bridge, "text")
    assert all(b"tester" in one for one in heard)
    until(bridge, lambda: "of other nodes refused" in bridge.module.status)


def test_node_stays_known_whatever_number_its_publisher_has() -> None:
    """CycloneDDS's Python gives the same number signed or unsigned: every other node was forgotten."""
    side = object.__new__(DdsSide)
    side.admission = Admission(["/slam"], 1)
    side.admission.tell(b"participant", {b"a": "/slam"})
    side._tellers = {(1 << 64) - 5: b"participant"}
    side._names = SimpleNamespace(get_matched_publications=lambda: [-5])
    side._forget_names()
    assert side.admission.admits(b"a")
    side._names = SimpleNamespace(get_matched_publications=lambda: [])
    side._forget_names()
    assert not side.admission.admits(b"a")


def test_services_of_the_robot_are_not_there_for_other_nodes(ros: Ros) -> None:
    bridge, node = ros
    assert node.run(CALL) is False

    def has_ended() -> bool:
        for request in bridge.take(CancelNavigation, service_topic("")):
            bridge.reply(request, NavigationCancelled())
        return bool(node.run("result = answer.done() and answer.result().success"))

    until(bridge, has_ended)


def test_services_of_other_nodes_are_not_called(ros: Ros) -> None:
    bridge, node = ros
    node.run(SERVE.format(who="intruder"))

    def answer() -> Any:
        bridge.bus.published.clear()
        bridge.send(SaveMap(call=1), topic=service_topic(""), sender="mission")
        until(bridge, lambda: bridge.published)
        return bridge.published[0].message

    for _ in range(3):
        assert "no node serves /save" in answer().reason
    node.run("intruder.destroy_service(serving)")
    node.run(SERVE.format(who="node"))
    until(bridge, lambda: getattr(answer(), "message", "") == "saved")
