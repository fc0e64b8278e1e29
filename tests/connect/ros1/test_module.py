"""The bridge to ROS 1 without ROS: what it refuses, what messages become, and what waits for a slow side."""

import hashlib
import json
import logging
import math
import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robbie_mp.connect.ros1 import ros_node
from robbie_mp.connect.ros1.conversion import ros1_type
from robbie_mp.connect.ros1.module import Ros1Bridge
from robbie_mp.connect.ros1.process import (
    MISSING_PAUSE_S,
    AnnouncedType,
    NodeInbox,
    NodeOutbox,
    RosAddress,
    RosProcess,
)
from robbie_mp.connect.ros1.ros_node import FIRST_ANNOUNCED, MAX_ANNOUNCED, MESSAGE, NodeFrame, frames, pack
from robbie_mp.messages import (
    DriveCommand,
    Header,
    LaserScan,
    Message,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    TFMessage,
    Time,
    TransformStamped,
    Twist,
    Vector3,
)
from robbie_mp.messages.primitives import float32
from robbie_mp.module.harness import ModuleHarness
from robbie_mp.module.settings import SettingError

ACCEPT = {
    "/cmd_vel": "Twist as DriveCommand manual",
    "/initialpose": "PoseWithCovarianceStamped as PoseStamped initial_pose",
    "/scan": "LaserScan scan",
    "/gas": "nose_msgs/* gas",
    "/any": "* other",
}
SEND = {"TFMessage tf": "/tf", "TFMessage tf_static": "/tf_static latched", "LaserScan": "/front"}
NOWHERE = "http://127.0.0.1:1"
POSE_OF_RVIZ = (
    "000000006656046b32620719030000006d6170000000404633e03f00000040c5e5f03f00000000000000000000000000"
    "0000000000000000000000e4527ace7c31cabf8e2829b3a452ef3f000000000000d03f00000000000000000000000000"
    "0000000000000000000000000000000000000000000000000000000000000000000000000000000000d03f00000000"
)
"""Recorded from *2D Pose Estimate* of RViz 1.14; zeros and the variance of the yaw follow."""
Bridge = ModuleHarness[Ros1Bridge]


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    settings = {"master": NOWHERE, "accept": ACCEPT, "send": SEND, "command_valid_s": 0.5}
    with ModuleHarness(Ros1Bridge, settings) as harness:
        yield harness


def arrive(bridge: Bridge, name: str, message: object, waited_s: float = 0.0, cut: int = 0) -> bool:
    """Let a message arrive from ROS; return whether the bridge took it."""
    kind = ros1_type(type(message))  # type: ignore[arg-type]
    incoming = next(one for one in bridge.module.map.incoming if one.name == name)
    data = kind.to_ros1(message.encode())  # type: ignore[attr-defined]
    return bridge.module._take(incoming, kind, data[: len(data) - cut], waited_s)


def sent(bridge: Bridge, number: int) -> TFMessage:
    """The newest message that waits for ROS on a channel."""
    channel = next(one for one in bridge.module._channels.values() if one and one.number == number)
    frame = bridge.module.ros._kept[number]
    assert isinstance(channel.kind.message_type, type)
    return TFMessage.decode(channel.kind.from_ros1(frame[len(pack(MESSAGE, 0, b"")) :]))


def test_a_velocity_becomes_a_command_that_expires_from_its_arrival(bridge: Bridge) -> None:
    assert arrive(bridge, "/cmd_vel", Twist(linear=Vector3(x=0.25)), waited_s=0.2)
    (command,) = bridge.take(DriveCommand, topic="manual")
    assert command.linear_m_per_s == 0.25
    assert command.valid_for.seconds == pytest.approx(0.3)


def test_frames_have_other_names_in_ros() -> None:
    settings = {"master": NOWHERE, "accept": ACCEPT, "send": SEND, "frames": {"*": "red/{frame}"}}
    with ModuleHarness(Ros1Bridge, settings) as bridge:
        bridge.send(transforms("odom", "base_link"), topic="tf_static")
        number = next(iter(bridge.module._channels.values())).number  # type: ignore[union-attr]
        (one,) = sent(bridge, number).transforms
        assert (one.header.frame_id, one.child_frame_id) == ("red/odom", "red/base_link")
        assert arrive(bridge, "/initialpose", PoseWithCovarianceStamped(header=Header(frame_id="red/map")))
        assert not arrive(bridge, "/initialpose", PoseWithCovarianceStamped(header=Header(frame_id="map")))
        (taken,) = bridge.take(PoseStamped, topic="initial_pose")
        assert taken.header.frame_id == "map"


def transforms(parent: str, child: str) -> TFMessage:
    """A message with one transform."""
    return TFMessage(transforms=[TransformStamped(header=Header(frame_id=parent), child_frame_id=child)])


@pytest.mark.parametrize(("speed", "waited_s"), [(0.25, 0.5), (math.nan, 0.0), (math.inf, 0.0)])
def test_an_old_or_endless_velocity_is_refused(bridge: Bridge, speed: float, waited_s: float) -> None:
    assert not arrive(bridge, "/cmd_vel", Twist(linear=Vector3(x=speed)), waited_s)


def test_velocity_whose_publisher_does_not_say_what_it_has_sent_is_refused(
    bridge: Bridge, caplog: pytest.LogCaptureFixture
) -> None:
    kind = ros1_type(Twist)
    (number,) = (number for number, (one, _) in bridge.module._incoming.items() if one.name == "/cmd_vel")
    for _ in range(30):
        frame = NodeFrame(MESSAGE, number, 0, kind.to_ros1(Twist(linear=Vector3(x=0.25)).encode()))
        bridge.module.ros._inbox.push(frame)
        bridge.advance(0.05)
    assert not bridge.take(DriveCommand, topic="manual")
    assert bridge.module.refused == 30
    (said,) = [one for one in caplog.messages if "/cmd_vel" in one]
    assert "of unknown age" in said


def test_an_initial_pose_is_taken_without_its_covariance(bridge: Bridge) -> None:
    def pose(x: float) -> PoseWithCovarianceStamped:
        return PoseWithCovarianceStamped(pose=PoseWithCovariance(pose=Pose(position=Point(x=x))))

    assert not arrive(bridge, "/initialpose", pose(math.nan))
    assert arrive(bridge, "/initialpose", pose(2.0))
    (taken,) = bridge.take(PoseStamped, topic="initial_pose")
    assert taken.pose.position.x == 2.0


def test_what_rviz_publishes_is_an_initial_pose(bridge: Bridge) -> None:
    raw = bytes.fromhex(POSE_OF_RVIZ) + bytes(213) + bytes.fromhex("10e9b73b4eb13f")
    (number,) = (number for number, (one, _) in bridge.module._incoming.items() if one.name == "/initialpose")
    assert not bridge.module._arrive(number, raw[:-1], 0.0)
    assert bridge.module._arrive(number, raw, 0.0)
    (taken,) = bridge.take(PoseStamped, topic="initial_pose")
    assert (taken.header.frame_id, taken.pose.position.x) == ("map", 0.5062590837478638)
    assert taken.pose.orientation.w == 0.9788383006318939


def test_damaged_bytes_reach_no_module(bridge: Bridge) -> None:
    assert not arrive(bridge, "/scan", LaserScan(header=Header(frame_id="laser")), cut=1)
    assert arrive(bridge, "/scan", LaserScan(header=Header(frame_id="laser")))


def announce(bridge: Bridge, topic: str, name: str, definition: str, md5: str = "") -> int:
    """Let ROS announce a type on a topic; return the number of its messages."""
    channel = next(number for number, (one, _) in bridge.module._incoming.items() if one.name == topic)
    md5 = md5 or hashlib.md5(definition.encode()).hexdigest()
    return bridge.module.ros._number(AnnouncedType(channel, name, md5, definition))


def test_a_type_that_only_ros_knows_is_published_as_that_type(bridge: Bridge) -> None:
    number = announce(bridge, "/gas", "nose_msgs/Gas", "uint16 ppm")
    assert bridge.module._arrive(number, b"\7\0", 0.0)
    (one,) = bridge.published_encoded
    assert (one.type_name, one.version, one.topic) == ("nose_msgs/msg/Gas", 1, "gas")
    assert one.data == b"\0\1\0\0\7\0"
    assert not bridge.module._arrive(number, b"\7", 0.0)  # a message that was cut off


def test_a_type_that_cannot_be_learnt_is_refused_and_named_once(
    bridge: Bridge, caplog: pytest.LogCaptureFixture
) -> None:
    refused = {
        announce(bridge, "/gas", "nose_msgs/Gas", "uint16 ppm", md5="abc"): "its publisher says 'abc'",
        announce(bridge, "/gas", "other_msgs/Gas", "uint16 ppm"): "`accept` takes only nose_msgs",
        announce(bridge, "/any", "robbie_msgs/DriveCommand", "uint16 ppm"): "the robot knows this type",
    }
    for number in [*refused] * 2:
        assert not bridge.module._arrive(number, b"\7\0", 0.0)
    said = [record.getMessage() for record in caplog.records if "is refused" in record.getMessage()]
    assert len(said) == len(refused)
    assert all(reason in line for reason, line in zip(refused.values(), said, strict=True))
    assert bridge.published_encoded == []


def test_a_type_has_one_definition_in_a_run(bridge: Bridge) -> None:
    first = announce(bridge, "/gas", "nose_msgs/Gas", "uint16 ppm")
    second = announce(bridge, "/any", "nose_msgs/Gas", "uint8 ppm")
    assert bridge.module._arrive(first, b"\7\0", 0.0)
    assert not bridge.module._arrive(second, b"\7", 0.0)


def test_a_type_that_the_code_of_the_robot_declares_is_refused(
    bridge: Bridge, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "late.py").write_text('class Gas(Message, name="nose_msgs/msg/Gas"): ...')
    bridge.module.surroundings = replace(bridge.module.surroundings, code=(tmp_path,))
    number = announce(bridge, "/gas", "nose_msgs/Gas", "uint16 ppm")
    assert not bridge.module._arrive(number, b"\7\0", 0.0)
    assert f"{tmp_path}/late.py declares a type of that name" in caplog.text
    assert bridge.module._arrive(announce(bridge, "/gas", "nose_msgs/Ga", "uint16 ppm"), b"\7\0", 0.0)


def test_types_that_ros_announces_are_limited(bridge: Bridge, caplog: pytest.LogCaptureFixture) -> None:
    numbers = [announce(bridge, "/any", f"a/T{i}", "uint8 x") for i in range(MAX_ANNOUNCED + 1)]
    assert bridge.module._arrive(numbers[0], b"\1", 0.0)
    assert announce(bridge, "/any", "a/T0", "uint8 x") == numbers[0]  # the node was started again
    assert not bridge.module._arrive(numbers[-1], b"\1", 0.0)
    assert f"more than {MAX_ANNOUNCED} types" in caplog.text


def test_a_latched_topic_has_all_fixed_transforms(bridge: Bridge) -> None:
    for name in ("laser", "camera"):
        bridge.send(TFMessage(transforms=[TransformStamped(child_frame_id=name)]), topic="tf_static")
    (channel,) = (one for one in bridge.module._channels.values() if one)
    assert [one.child_frame_id for one in sent(bridge, channel.number).transforms] == ["laser", "camera"]


def test_a_topic_that_nobody_hears_is_not_converted(bridge: Bridge) -> None:
    bridge.send(LaserScan())
    assert (bridge.module.unheard, bridge.module.sent) == (1, 0)


def test_what_came_from_ros_does_not_go_back(bridge: Bridge) -> None:
    bridge.send(LaserScan(), sender="camera")
    (channel,) = (one for one in bridge.module._channels.values() if one)
    bridge.module.ros.listeners = {channel.number: 1}
    bridge.send(LaserScan(), sender="module")  # the bridge's own name
    assert bridge.module.sent == 0
    bridge.send(LaserScan(), sender="camera")
    assert bridge.module.sent == 1


def wish(topic: str, kind: str = "", *, latched: bool) -> dict[str, object]:
    """What the node reads about a subscriber."""
    return {"topic": topic, "md5": kind, "type": kind, "definition": "", "depth": 1, "latched": latched}


def test_node_ignores_what_it_has_published_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    subscribed: dict[str, Any] = {}
    rospy = SimpleNamespace(
        AnyMsg=object,
        get_name=lambda: "/robbie",
        get_node_uri=lambda: NOWHERE,
        Subscriber=lambda topic, _kind, take, **_options: subscribed.update({topic: take}),
    )
    pushed: list[bytes] = []
    outbox = SimpleNamespace(push=lambda _kind, _channel, data, _sent_ns: pushed.append(data))
    monkeypatch.setenv("ROS_MASTER_URI", NOWHERE)
    near, far = socket.socketpair()
    with near, far:
        node = ros_node._Node(rospy, near, outbox)  # type: ignore[arg-type]
        node._open_subscriber(
            1, {"topic": "/scan", "md5": "", "type": "", "definition": "", "depth": 1, "latched": True}
        )
        for caller in ("/robbie", "/other"):
            header = {"callerid": caller}
            subscribed["/scan"](SimpleNamespace(_connection_header=header, _buff=caller.encode()))
    assert pushed == [b"/other"]


@pytest.mark.parametrize("takes_kept", [True, False])
def test_order_that_ros_has_kept_from_before_is_not_given_again(
    monkeypatch: pytest.MonkeyPatch, takes_kept: bool
) -> None:
    subscribed: dict[str, Any] = {}
    rospy = SimpleNamespace(
        AnyMsg=object,
        get_name=lambda: "/robbie",
        get_node_uri=lambda: NOWHERE,
        Subscriber=lambda topic, _kind, take, **_options: subscribed.update({topic: take}),
    )
    now_s = [10.0]
    monkeypatch.setattr(ros_node, "time", SimpleNamespace(monotonic=lambda: now_s[0], monotonic_ns=lambda: 1))
    pushed: list[bytes] = []
    outbox = SimpleNamespace(push=lambda _kind, _channel, data, _sent_ns: pushed.append(data), dropped=0)
    monkeypatch.setenv("ROS_MASTER_URI", NOWHERE)
    near, far = socket.socketpair()
    with near, far:
        node = ros_node._Node(rospy, near, outbox)  # type: ignore[arg-type]
        node._open_subscriber(1, wish("/cmd_vel", latched=takes_kept))
        for latching, at_s, data in (("1", 10.1, b"old"), ("0", 10.2, b"stream"), ("1", 13.0, b"later")):
            now_s[0] = at_s
            header = {"callerid": "/other", "latching": latching}
            subscribed["/cmd_vel"](SimpleNamespace(_connection_header=header, _buff=data))
    assert pushed == [b"old"] * takes_kept + [b"stream", b"later"]
    assert outbox.dropped == (not takes_kept)


def test_node_announces_the_type_of_each_connection_once(monkeypatch: pytest.MonkeyPatch) -> None:
    subscribed: dict[str, Any] = {}
    rospy = SimpleNamespace(
        AnyMsg=object,
        get_name=lambda: "/robbie",
        get_node_uri=lambda: NOWHERE,
        Subscriber=lambda topic, _kind, take, **_options: subscribed.update({topic: take}),
    )
    monkeypatch.setenv("ROS_MASTER_URI", NOWHERE)
    near, far = socket.socketpair()
    with near, far:
        outbox = ros_node._Outbox(near)
        node = ros_node._Node(rospy, near, outbox)
        node._open_subscriber(
            1, {"topic": "/any", "md5": "*", "type": "*", "definition": "", "depth": 1, "latched": True}
        )
        for i in range(MAX_ANNOUNCED + 1):
            header = {
                "callerid": "/other",
                "type": f"a/T{i}",
                "md5sum": "abc",
                "message_definition": "uint8 x",
            }
            for _ in range(2):
                subscribed["/any"](SimpleNamespace(_connection_header=header, _buff=b"1"))
    assert len(outbox._announcements) == MAX_ANNOUNCED
    head = ros_node.FRAME.size
    first = AnnouncedType(**json.loads(outbox._announcements[0][head:]))
    assert first == AnnouncedType(1, "a/T0", "abc", "uint8 x")
    channels = [ros_node.FRAME.unpack(frame[:head])[2] for _, frame in outbox._waiting]
    assert channels[:3] == [FIRST_ANNOUNCED, FIRST_ANNOUNCED, FIRST_ANNOUNCED + 1]
    assert channels[-1] == 1  # no number was left


def test_a_moving_transform_is_sent_once_for_each_time(bridge: Bridge) -> None:
    def move(nanosec: int) -> None:
        header = Header(stamp=Time(nanosec=nanosec))
        bridge.send(
            TFMessage(transforms=[TransformStamped(header=header, child_frame_id="odom")]), topic="tf"
        )

    move(1)
    (channel,) = (one for one in bridge.module._channels.values() if one)
    bridge.module.ros.listeners = {channel.number: 1}
    for nanosec in (2, 2, 3):
        move(nanosec)
    assert bridge.module.sent == 2
    bridge.send(TFMessage(), topic="tf")  # an empty one is a message, too
    assert bridge.module.sent == 3


@pytest.mark.parametrize(
    ("setting", "value", "reason"),
    [
        ("send", {"LaserScan": "not a name"}, "not a quality"),
        ("accept", {"/cmd_vel": "LaserScan as DriveCommand"}, "can become a DriveCommand"),
        ("accept", {"/goal": "PoseStamped as Twist"}, "a message can become"),
        ("node", "my robot", "cannot be called"),
    ],
)
def test_wrong_settings_are_named(setting: str, value: object, reason: str) -> None:
    with pytest.raises(SettingError, match=reason):
        ModuleHarness(Ros1Bridge, {setting: value})


def test_types_that_modules_declare_may_be_accepted() -> None:
    class Odour(Message, name="ros1_test_msgs/msg/Odour"):
        strength: float32

    Ros1Bridge.check(
        {"send": {}, "accept": {"/odour": Odour.type_name}, "namespace": "", "frames": {}, "node": "robbie"}
    )


def test_a_slow_ros_node_costs_the_oldest_messages_of_the_same_topic() -> None:
    outbox = NodeOutbox(max_bytes=100)
    for number in range(4):
        outbox.push(1, bytes([number]), depth=2)
    outbox.push(2, b"other", depth=2)
    outbox.push(2, bytes(101), depth=2)
    outbox.order(b"order")
    assert [outbox.pop() for _ in range(4)] == [b"order", b"\2", b"\3", b"other"]
    assert outbox.dropped == 3
    outbox.push(1, b"left", depth=2)
    outbox.close()
    assert outbox.pop() is None
    assert outbox.dropped == 4


def test_messages_that_wait_are_limited_in_bytes() -> None:
    outbox = NodeOutbox(max_bytes=10)
    for number in range(3):
        outbox.push(1, bytes([number]) * 6, depth=100)
    assert (outbox.pop(), outbox.dropped) == (b"\2" * 6, 2)


def test_a_slow_bridge_loses_the_oldest_messages() -> None:
    inbox = NodeInbox()
    for number in range(1005):
        inbox.push(NodeFrame(MESSAGE, 1, 0, str(number).encode()))
    taken = inbox.take()
    assert (len(taken), taken[0].payload, inbox.dropped) == (1000, b"5", 5)
    assert inbox.take() == []


def test_a_missing_python_is_named_once(caplog: pytest.LogCaptureFixture) -> None:
    log, now = logging.getLogger("ros1"), [0.0]
    address = RosAddress(NOWHERE, "127.0.0.1", "robbie", Path("/nowhere/python3"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robbie_mp.connect.ros1.process.time.monotonic", lambda: now[0])
        ros = RosProcess(address, 1000, log, lambda: None)
        for now[0] in (0.0, 1.0, MISSING_PAUSE_S, 2 * MISSING_PAUSE_S):
            ros.look_after()
    assert ros.starts == 3
    assert [record.getMessage().count("/nowhere/python3") for record in caplog.records] == [1]


def test_a_frame_cut_off_is_no_frame() -> None:
    here, there = socket.socketpair()
    with closing(here), closing(there):
        here.sendall(pack(MESSAGE, 7, b"whole") + pack(MESSAGE, 7, b"cut")[:-1])
        here.shutdown(socket.SHUT_WR)
        assert [(one.channel, one.payload) for one in frames(there)] == [(7, b"whole")]
