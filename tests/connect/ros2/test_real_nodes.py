"""The bridge over DDS beside real nodes of ROS 2: rclpy from wheels, and the ROS of this shell."""

import itertools
import json
import os
import pathlib
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from robbie_mp import Module, ModuleHarness, Reply, Request, setting
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.rtps import wire
from robbie_mp.connect.ros2.rtps.participant import Participant
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages import (
    CancelNavigation,
    DriveCommand,
    EmergencyStop,
    Header,
    Image,
    LaserScan,
    Message,
    NavigationCancelled,
    Path,
    PoseStamped,
    SettingChange,
    SettingChanged,
    String,
    from_dict,
)
from robbie_mp.messages.stock.registry import stock_registry
from robbie_mp.module.calls.peers import service_topic
from robbie_mp.module.setting_changes import SettingChanges, SettingsFile
from tests._support.places import PROJECT
from tests._support.robot import LIMIT_S, wait_until
from tests.connect.ros2._support.ros_nodes import DISTRIBUTIONS, RosNode, ros_node, until

pytestmark = [pytest.mark.slow, pytest.mark.every_turn]
RESEND_S = 1.0
DOMAIN = 20 + os.getpid() % 80
JAZZY = get_typestore(Stores.ROS2_JAZZY)
STOCK = {f"t{number}": one for number, one in enumerate(stock_registry()) if one.type_name in JAZZY.fielddefs}
SETTINGS: dict[str, Any] = {
    "middleware": "dds",
    "node": "red",
    "namespace": "team",
    "send": {
        "* all/*": "/{topic}",
        "LaserScan": "/scan best_effort depth=5",
        "String": "/name latched depth=1",
    },
    "accept": {
        "/text": "String text latched",
        "/cmd_vel": "Twist as DriveCommand ros",
        **{f"/back/{topic}": f"{one.type_name} {topic}" for topic, one in STOCK.items()},
    },
    "services": {
        "/abort": "CancelNavigation {reason: from ROS}",
        "/go": "CancelNavigation {client: go} or {client: halt}",
    },
    "calls": {"/slam/save": "std_srvs/srv/Trigger", "/slam/load": "SetBool maps"},
}
NAMES = [f"setting_{number}_with_a_name_that_is_longer_than_most" for number in range(3000)]
"""Enough for responses and requests that do not fit into one datagram."""
LISTEN = """
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from geometry_msgs.msg import Twist
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
node.create_subscription(LaserScan, "/scan", lambda scan: got["scan"].append(list(scan.ranges)), best_effort)
node.create_subscription(String, "/name", lambda text: got["name"].append(text.data), latched)
node.create_subscription(LaserScan, "/scan", got["strict"].append, 10)
node.create_publisher(String, "/text", latched).publish(String(data="from ROS"))
velocity = node.create_publisher(Twist, "/cmd_vel", 10)
"""
LOOK = """
twist = Twist()
twist.linear.x, twist.angular.z = 0.4, 0.1
velocity.publish(twist)
kinds = [str(one.topic_type_hash) for one in node.get_publishers_info_by_topic("/scan")]
is_seen = ("red", "/team") in node.get_node_names_and_namespaces()
own = dict(node.get_publisher_names_and_types_by_node("red", "/team")) if is_seen else {}
result = {**got, "own": own, "kinds": kinds}
"""
CONFUSE = """
from std_msgs.msg import Bool
context = rclpy.Context()
rclpy.init(context=context, domain_id=domain)
other = rclpy.create_node("confused", context=context)
other.create_publisher(Bool, "/cmd_vel", 10)
"""
ECHO = """
from importlib import import_module
for topic, name in kinds.items():
    package, _, short = name.split("/")
    try:
        kind = getattr(import_module(package + ".msg"), short)
    except (ImportError, AttributeError):
        continue  # this ROS is installed without the package
    back = node.create_publisher(kind, "/back/" + topic, 10)
    node.create_subscription(kind, "/all/" + topic, back.publish, 10)
    got["kinds"].append(topic)
result = got["kinds"]
"""


# A client keeps ten responses that it has not looked at yet, so no more may come at once.
CALL = """
from std_srvs.srv import SetBool, Trigger
abort, go = node.create_client(Trigger, "/abort"), node.create_client(SetBool, "/go")
assert abort.wait_for_service(10.0) and go.wait_for_service(10.0)
calls = [go.call_async(SetBool.Request(data=number % 2 == 0)) for number in range(8)]
calls.append(abort.call_async(Trigger.Request()))
"""
HAVE_ENDED = "result = [one.done() and (one.result().success, one.result().message) for one in calls]"
ASK = """
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
settings = AsyncParameterClient(node, "/team/red")
assert settings.wait_for_services(10.0)
changed = [Parameter("mapping.frame", value="odom"), Parameter("mapping.resolution_m", value=0.1)]
answers = [settings.list_parameters([], 0), settings.get_parameters(names), settings.set_parameters(changed)]
"""
ANSWERS = """
result = None
if all(one.done() for one in answers):
    listed, values, done = (one.result() for one in answers)
    types, are_changed = [one.type for one in values.values], [one.successful for one in done.results]
    result = [listed.result.names, types, are_changed]
"""


class Mapping(Module):
    """A module with two settings."""

    resolution_m: float = setting(0.05, "edge of a cell", minimum=0.01, maximum=1.0, changeable=True)
    frame: str = setting("map", "its frame")


SERVE = """
from std_srvs.srv import Trigger
def save(request, response):
    response.success, response.message = True, "x" * 100_000
    return response
serving = node.create_service(Trigger, "/slam/save", save)
"""
SERVE_SILENTLY = """
from std_srvs.srv import SetBool
context = rclpy.Context()
rclpy.init(context=context, domain_id=domain)
silent = rclpy.create_node("silent", context=context)
silent.create_service(SetBool, "/slam/load", None)
"""
END_SILENTLY = "silent.destroy_node()\nrclpy.shutdown(context=context)"


class Saved(Reply, name="std_srvs/srv/Trigger_Response"):
    success: bool
    message: str


class SaveMap(Request[Saved], name="std_srvs/srv/Trigger_Request"):
    pass


class Loaded(Reply, name="std_srvs/srv/SetBool_Response"):
    success: bool
    message: str


class LoadMap(Request[Loaded], name="std_srvs/srv/SetBool_Request"):
    data: bool


class Ros(NamedTuple):
    """A bridge, and a real node beside it."""

    bridge: ModuleHarness[Ros2Bridge]
    node: RosNode


@pytest.fixture(scope="module", params=DISTRIBUTIONS)
def ros(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros]:
    domain = DOMAIN + DISTRIBUTIONS.index(request.param)
    with (
        ros_node(request.param, domain, tmp_path_factory.mktemp("ros")) as node,
        ModuleHarness(Ros2Bridge, {**SETTINGS, "domain": domain}) as bridge,
    ):
        bridge.module.ill_formed.admits = lambda *_: True  # type: ignore[method-assign]  # bytes, not sense
        yield Ros(bridge, node)


def test_messages_pass_both_ways_and_ros_sees_the_node(ros: Ros) -> None:
    bridge, node = ros
    bridge.send(String(data="red robot"), topic="name")  # before anybody listens
    node.run(LISTEN)
    scan = LaserScan(header=Header(frame_id="laser"), ranges=np.array([1.0, 2.5], np.float32))
    told: dict[str, Any] = {}

    def is_done() -> bool:
        bridge.send(scan, topic="laser")
        told.update(node.run(LOOK))
        is_heard = bridge.published and bridge.published_encoded and bridge.module.side.incompatible
        return bool(is_heard and "/scan" in told["own"] and told.get("scan") and told.get("name"))

    until(bridge, is_done)
    assert told["scan"][0] == [1.0, 2.5]
    assert told["name"] == ["red robot"]
    assert type_hash(LaserScan).partition("_")[2] in told["kinds"][0].lower()
    assert not told["strict"]  # it needs reliable scans
    assert String.decode(bridge.published_encoded[0].data) == String(data="from ROS")
    drive = bridge.take(DriveCommand, "ros")[-1]
    assert (drive.linear_m_per_s, drive.angular_rad_per_s) == (0.4, 0.1)
    assert 0 < drive.valid_for.nanoseconds <= 500_000_000


def test_publisher_of_another_type_is_named(ros: Ros, caplog: pytest.LogCaptureFixture) -> None:
    bridge, node = ros
    node.run(CONFUSE, domain=bridge.module.domain)
    until(bridge, lambda: any("/cmd_vel has the type" in one for one in caplog.messages))
    (named,) = [one for one in caplog.messages if "/cmd_vel has the type" in one]
    assert "std_msgs::msg::dds_::Bool_" in named
    node.run("other.destroy_node()\nrclpy.shutdown(context=context)")


@pytest.fixture(scope="module")
def echoed(ros: Ros) -> list[str]:
    """The topics whose messages the node sends back."""
    topics: list[str] = ros.node.run(ECHO, kinds={topic: one.type_name for topic, one in STOCK.items()})
    return topics


def test_every_stock_type_of_ros_returns_from_a_node_unchanged(ros: Ros, echoed: list[str]) -> None:
    bridge, count = ros.bridge, itertools.count(1)
    assert len(echoed) >= 30
    sent = {
        topic: from_dict(STOCK[topic], filled((Nodetype.NAME, STOCK[topic].type_name), count))
        for topic in echoed
    }
    wait_until_returned(bridge, sent)


@pytest.mark.usefixtures("echoed")
def test_large_image_and_long_path_return_from_a_node_unchanged(ros: Ros) -> None:
    topics = {one: topic for topic, one in STOCK.items()}
    pixels = np.random.default_rng(1).integers(0, 256, 1920 * 1080 * 3, np.uint8)
    image = Image(height=1080, width=1920, encoding="rgb8", step=5760, data=pixels)
    path = Path(poses=[PoseStamped(header=Header(frame_id="map")) for _ in range(1000)])
    sent: dict[str, Message] = {topics[Image]: image, topics[Path]: path}
    wait_until_returned(ros.bridge, sent)


LOOK_LATE = """
import threading
from sensor_msgs.msg import Image
is_free = threading.Event()
def on_image(image):
    got["sizes"].append(len(image.data))
    is_free.wait(60.0)
node.create_subscription(Image, "/late", on_image, 1)
"""


@pytest.mark.timeout(120)
def test_busy_node_goes_on_when_a_message_of_which_it_has_parts_is_gone(ros: Ros) -> None:
    """A GAP for that message would make FastDDS read for ever what it has of it."""
    node, image = ros.node, Image(height=100, width=600, step=1800, data=np.zeros(180_000, np.uint8)).encode()
    with closing(Participant(ros.bridge.module.domain, "lo", lambda topic: topic == "rt/late")) as peer:
        told = f"typehash={type_hash(Image)};".encode()
        writer = peer.add_writer("rt/late", "sensor_msgs::msg::dds_::Image_", told)
        writer.kept = 1
        node.run(LOOK_LATE)
        wait_until(lambda: bool(writer.readers))
        (reader,) = writer.readers
        send = writer.send

        def send_no_data(to: bytes, parts: list[bytes]) -> None:
            send(to, [one for one in parts if one[0] not in (wire.DATA, wire.DATA_FRAG)])

        with peer.lock:
            writer.write(image)
        wait_until(lambda: node.run("result = got['sizes']") == [180_000])
        with peer.lock:
            writer.write(image)  # it waits: the node is busy with the first one
        wait_until(lambda: writer.readers[reader].acknowledged == 2)
        with peer.lock:
            writer.send = lambda to, parts: send(to, parts[:1])
            writer.write(image)
            writer.send = lambda _to, _parts: None
            writer.write(image)  # the third one is not kept any more
            writer.send = send_no_data
            writer.on_acknack(reader, 3, [3])
        wait_until(lambda: writer.readers[reader].acknowledged == 3)
        node.run("is_free.set()")
        writer.send = send
        wait_until(lambda: len(node.run("result = got['sizes']")) > 1)


def asked_of_the_robot(bridge: ModuleHarness[Ros2Bridge]) -> list[Any]:
    """Return the requests that the bridge has sent to modules of the robot since this was called last."""
    name = CancelNavigation.type_name
    found = [one.message for one in bridge.published if one.message.type_name == name]
    bridge.bus.published.clear()
    return found


def test_each_of_many_requests_gets_its_own_response(ros: Ros) -> None:
    bridge, node = ros
    node.run(CALL)
    told: list[Any] = []

    def have_all_ended() -> bool:
        for request in reversed(asked_of_the_robot(bridge)):
            if request.reason:
                bridge.refuse(request, "not now")
            else:
                bridge.reply(request, NavigationCancelled(client=request.client))
        told[:] = node.run(HAVE_ENDED)
        return all(told)

    until(bridge, have_all_ended)
    replies = [[True, json.dumps({"client": client})] for client in ("go", "halt")]
    assert told == [*(replies * 4), [False, "not now"]]


def test_client_of_cyclonedds_is_served_beside_one_of_fastdds(ros: Ros) -> None:
    bridge, node = ros
    node.run(CALL)
    command = [sys.executable, "-m", "tests.connect.ros2.dds_client", str(bridge.module.domain)]
    with subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, text=True) as client:

        def have_all_ended() -> bool:
            for request in asked_of_the_robot(bridge):
                bridge.reply(request, NavigationCancelled(client=f"{request.client}ed"))
            return all(node.run(HAVE_ENDED)) and client.poll() is not None

        until(bridge, have_all_ended)
        told = json.loads(client.communicate()[0])
    assert told["response"] == [0x1122334455667788, 5, True, '{"client": "halted"}']


def test_emergency_stop_is_answered_by_what_the_base_says(ros: Ros) -> None:
    bridge, node = ros
    node.run(CALL.replace("/abort", "/team/emergency_stop/engage"))

    def has_ended() -> bool:
        if bridge.take(EmergencyStop, "emergency_stop"):
            bridge.send(EmergencyStop(engaged=True), topic="emergency_stop_state")
        return bool(node.run(HAVE_ENDED)[-1])

    until(bridge, has_ended)
    assert node.run(HAVE_ENDED)[-1] == [True, "the robot stands still"]


def test_settings_are_parameters_also_if_they_need_many_datagrams(ros: Ros, tmp_path: pathlib.Path) -> None:
    bridge, node = ros
    file = SettingsFile(tmp_path, "mapping")
    mapping = ModuleHarness(Mapping, name="mapping")
    SettingChanges(mapping.module, mapping.bus, file).listen()
    assert bridge.module.node_parameters is not None
    bridge.module.node_parameters.files = {"mapping": file}
    node.run(ASK, names=["mapping.frame", *NAMES])

    def have_all_ended() -> bool:
        for change in bridge.take(SettingChange, "mapping"):
            bridge.send(SettingChanged(request=change.request), topic="mapping")
        return node.run(ANSWERS) is not None

    until(bridge, have_all_ended)
    names, types, are_changed = node.run(ANSWERS)
    assert sorted(names) == ["mapping.frame", "mapping.resolution_m"]
    assert types == [4, *([0] * len(NAMES))]
    assert are_changed == [False, True]


def ends_of(bridge: ModuleHarness[Ros2Bridge], request: Request[Any], topic: str = "") -> list[Any]:
    """Let a module call a service of ROS; return a list that its reply or refusal will come into."""
    bridge.bus.published.clear()
    bridge.send(request, topic=service_topic(topic), sender="mission")
    return bridge.published


def test_module_calls_a_service_of_ros(ros: Ros) -> None:
    bridge, node = ros
    node.run(SERVE)
    ends = ends_of(bridge, SaveMap(call=7))
    until(bridge, lambda: ends)
    (reply,) = (one.message for one in ends)
    assert (reply.type_name, reply.call, reply.success) == (Saved.type_name, 7, True)
    assert reply.message == "x" * 100_000
    assert ends[0].topic == "mission"
    node.run("node.destroy_service(serving)")
    until(bridge, lambda: "no node serves" in refusal_of(bridge, SaveMap(call=8)))


def refusal_of(bridge: ModuleHarness[Ros2Bridge], request: Request[Any], topic: str = "") -> str:
    """Let a module call a service of ROS; return why it was refused, or "" if it was not."""
    ends = ends_of(bridge, request, topic)
    until(bridge, lambda: ends)
    return getattr(ends[0].message, "reason", "")


def test_node_that_dies_before_it_responds_is_an_error(ros: Ros) -> None:
    bridge, node = ros
    assert "no node serves /slam/load" in refusal_of(bridge, LoadMap(call=1, data=True), "maps")
    node.run(SERVE_SILENTLY, domain=bridge.module.domain)
    side: Any = bridge.module.side
    until(bridge, side._services._clients["/slam/load"].servers)
    ends = ends_of(bridge, LoadMap(call=2, data=True), "maps")
    bridge.advance(0.1)
    assert not ends
    node.run(END_SILENTLY)
    until(bridge, lambda: ends)
    assert "has gone" in ends[0].message.reason


def wait_until_returned(bridge: ModuleHarness[Ros2Bridge], sent: dict[str, Message]) -> None:
    """Send messages until each has returned unchanged; repeat missing ones, at growing intervals.

    A busy machine that needs more than a second for a large message must not get another one every second.
    FastDDS leaves in the padding what its buffer had, so the messages are compared without it.
    """
    missing = {topic: message.encode() for topic, message in sent.items()}
    due_s, patience_s = time.monotonic(), RESEND_S

    def have_all_returned() -> bool:
        nonlocal due_s, patience_s
        if time.monotonic() >= due_s:
            due_s, patience_s = time.monotonic() + patience_s, 2 * patience_s
            for topic in missing:
                bridge.send(sent[topic], topic=f"all/{topic}")
        for one in bridge.published_encoded:
            if one.topic in missing and type(sent[one.topic]).decode(one.data).encode() == missing[one.topic]:
                del missing[one.topic]
        bridge.bus.published_encoded.clear()
        return not missing

    until(bridge, have_all_returned, LIMIT_S)


def filled(definition: Any, count: Iterator[int]) -> Any:
    """Return plain data for a field of a definition of Jazzy, with texts of several lengths."""
    kind, about = definition
    if kind is Nodetype.NAME:
        return {name: filled(inner, count) for name, inner in JAZZY.fielddefs[about][1]}
    if kind is Nodetype.ARRAY:
        return [filled(about[0], count) for _ in range(about[1])]
    if kind is Nodetype.SEQUENCE:
        return [filled(about[0], count) for _ in range(3)]
    number = next(count) % 100
    return {"string": "x" * (number % 7), "bool": bool(number % 2)}.get(about[0], number)
