"""The settings of a link, and a link alone."""

import io
import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as PillowImage

from robbie_mp import Header, ModuleHarness, SettingError
from robbie_mp.bus.transport.endpoint import NameTooLong, TooManyDeclarations
from robbie_mp.connect.link.clock_offset import Exchange
from robbie_mp.connect.link.frames import prefixed
from robbie_mp.connect.link.handshake import NotConnected, shake_hands
from robbie_mp.connect.link.header import MAGIC, VERSION, ChannelId, ReceivedPacket
from robbie_mp.connect.link.keys import Keys
from robbie_mp.connect.link.module import Link
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.sending import Item
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.wire import Endpoints, open_session
from robbie_mp.messages import (
    CompressedImage,
    DriveCommand,
    Duration,
    EmergencyStop,
    Image,
    LinkState,
    Message,
    Odometry,
    OperatorRequest,
    String,
    replace,
)

LINK_ALONE = """
import json, sys
from robbie_mp import ModuleHarness
from robbie_mp.connect.link.module import Link
from robbie_mp.bus.transport.endpoint import NameTooLong, TooManyDeclarations
with ModuleHarness(Link, json.loads(sys.argv[1])):
    print("ready", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module", autouse=True)
def zenoh_has_started() -> None:
    """Zenoh keeps some descriptors until the process ends; have it open them before any test looks."""
    open_session(Endpoints()).close()


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({}, "robot: required"),
        ({"robot": "red/blue"}, "cannot be called"),
        ({"robot": "red", "send": {"steady": ["Image"]}}, "there is no class 'steady'"),
        ({"robot": "red", "send": {"state": ["Image camera front"]}}, "with a space between"),
        ({"robot": "red", "accept": {"blue": [""]}}, "expected a type"),
        ({"robot": "red", "robots": ["blue"], "others": ["base*"]}, "`others` leaves it out"),
        ({"robot": "red", "listen": ["tls/127.0.0.1:7447"]}, "needs keys: make them with `robbie keys new`"),
        ({"robot": "red", "prefix_frames": True}, "frames get a prefix only if topics do"),
        (
            {"robot": "red", "listen": [], "connect": ["tcp/127.0.0.1:7447"], "keys": "keys"},
            "not encrypted, but `keys` is set; write tls/127.0.0.1:7447",
        ),
    ],
)
def test_wrong_settings_are_explained(settings: dict[str, object], problem: str) -> None:
    with pytest.raises(SettingError, match=problem):
        ModuleHarness(Link, settings)


def test_a_link_alone_shows_its_state() -> None:
    with ModuleHarness(Link, {"robot": "red", "listen": []}) as harness:
        harness.advance(1.1)
        state = harness.take(LinkState)[-1]
        assert state.robot == "red"
        assert state.peers == []


def test_a_link_exchanges_messages_only_with_the_robots_that_it_is_told() -> None:
    settings = {"robot": "red", "listen": [], "others": ["base*", "blue"]}
    with ModuleHarness(Link, settings) as harness:
        node = harness.module.node
        for robot in ("base1", "blue", "green", "red"):
            node.meet(robot)
        assert list(node.peers) == ["base1", "blue"]


def bulk_of(harness: ModuleHarness[Link], image: Image) -> Item:
    """The item as which a link sends an image to robot `blue`."""
    harness.send_encoded(image.type_name, image.version, image.encode(), topic="front")
    (item,) = harness.module.node.peers["blue"].streams[TrafficClass.BULK].waiting.values()
    return item


JPEG = {"robot": "red", "listen": [], "robots": ["blue"], "send": {"bulk": ["Image"]}, "jpeg_quality": 90}


def test_images_are_sent_as_jpeg_made_only_when_their_turn_has_come() -> None:
    ramp = np.tile(np.repeat(np.arange(120, dtype=np.uint8), 3), 120)
    camera = Header(frame_id="camera")
    image = Image(header=camera, height=120, width=120, encoding="rgb8", step=360, data=ramp)
    with ModuleHarness(Link, JPEG) as harness:
        item = bulk_of(harness, image)
        assert item.channel.name == (CompressedImage.type_name, CompressedImage.version, "front")
        assert item.data == image.encode()
        assert harness.module.node.peers["blue"].streams[TrafficClass.BULK].send_next(0)
        sent = CompressedImage.decode(item.data)
    assert (sent.header.frame_id, sent.format) == ("camera", "jpeg")
    assert len(item.data) < len(image.encode()) / 2
    shown = np.asarray(PillowImage.open(io.BytesIO(sent.data.tobytes())))
    assert np.abs(shown.astype(int) - ramp.reshape(120, 120, 3)).max() < 12


@pytest.mark.parametrize("changed", [{"encoding": "16UC1", "width": 60}, {"height": 9}, {"encoding": "odd"}])
def test_images_that_jpeg_would_spoil_are_sent_as_they_are(changed: dict[str, Any]) -> None:
    image = Image(height=8, width=120, encoding="mono8", step=120, data=np.zeros(960, np.uint8))
    image = replace(image, **changed)
    with ModuleHarness(Link, JPEG) as harness:
        item = bulk_of(harness, image)
        assert item.channel.name.type_name == Image.type_name
        assert harness.module.node.peers["blue"].streams[TrafficClass.BULK].send_next(0)
        assert item.data == image.encode()


def test_link_with_keys_lets_only_trusted_robots_connect(tmp_path: Path) -> None:
    red, blue, stranger = (Keys(tmp_path / name) for name in ("red", "blue", "stranger"))
    for keys in (red, blue, stranger):
        keys.make(keys.folder.name)
    red.trust(blue.own().file)
    for keys in (blue, stranger):
        keys.trust(red.own().file)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    settings = {"robot": "red", "listen": [f"tls/127.0.0.1:{port}"], "keys": str(red.folder)}
    command = [sys.executable, "-c", LINK_ALONE, json.dumps(settings)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        assert shake_hands(blue, "127.0.0.1", port) == "red"
        with pytest.raises(NotConnected, match="does not trust this robot"):
            shake_hands(stranger, "127.0.0.1", port)
        process.communicate()


def test_link_with_the_keys_of_another_robot_does_not_start(tmp_path: Path) -> None:
    Keys(tmp_path / "keys").make("blue")
    for folder, problem in (("keys", "are of blue, not of red"), ("none", "there are no keys in")):
        settings = {"robot": "red", "listen": [], "keys": str(tmp_path / folder)}
        with pytest.raises(SettingError, match=problem), ModuleHarness(Link, settings):
            pass


def arrive(message: Message, **settings: Any) -> tuple[Message, str]:
    """Return what a link publishes of a message of robot `red`, and its topic."""
    chosen = {
        "robot": "blue",
        "listen": [],
        "robots": ["red"],
        "accept": {"red": ["Odometry odom", "String odom"]},
    }
    with ModuleHarness(Link, {**chosen, **settings}) as harness:
        name = ChannelId(message.type_name, message.version, "odom")
        one = Arrived("red", 1, TrafficClass.STATE, 0, name, message.encode(), 0, 0, False)
        assert harness.module.on_arrived(one) is Fate.PUBLISHED
        (entry,) = harness.published_encoded
        return type(message).decode(entry.data), entry.topic


@pytest.mark.parametrize(
    "message",
    [Odometry(header=Header(frame_id="odom"), child_frame_id="base_link"), String(data="base_link")],
)
def test_link_puts_the_robots_name_before_topics_and_frames(message: Message) -> None:
    assert arrive(message) == (message, "odom")
    assert arrive(message, prefix_topics=True) == (message, "red/odom")
    found = arrive(message, prefix_topics=True, prefix_frames=True)
    assert found == (prefixed(message, "red/"), "red/odom")


def test_topic_that_begins_with_a_robots_name_is_for_that_robot_alone() -> None:
    settings = {"robot": "red", "listen": [], "send": {"urgent": ["EmergencyStop */emergency_stop"]}}
    with ModuleHarness(Link, {**settings, "prefix_topics": True}) as harness:
        node = harness.module.node
        for robot in ("blue", "green"):
            node.meet(robot)
        harness.send(EmergencyStop(engaged=True), topic="blue/emergency_stop")
        harness.advance(0.01)
        name = ChannelId(EmergencyStop.type_name, EmergencyStop.version, "blue/emergency_stop")
        assert node.holds("blue", name, TrafficClass.URGENT)
        assert not node.holds("green", name, TrafficClass.URGENT)


@pytest.mark.parametrize(
    ("topic", "here"),
    [
        ("red/emergency_stop", "emergency_stop"),
        ("emergency_stop", "blue/emergency_stop"),
        ("redder/odom", "blue/redder/odom"),
    ],
)
def test_what_another_robot_sends_to_this_one_has_no_prefix(topic: str, here: str) -> None:
    settings = {"robot": "red", "listen": [], "accept": {"blue": ["*"]}, "prefix_topics": True}
    with ModuleHarness(Link, settings) as harness:
        harness.module.node.meet("blue")
        name = ChannelId(EmergencyStop.type_name, EmergencyStop.version, topic)
        data = EmergencyStop(engaged=True).encode()
        one = Arrived("blue", 1, TrafficClass.URGENT, 0, name, data, 0, 0, False)
        assert harness.module.on_arrived(one) is Fate.PUBLISHED
        assert [entry.topic for entry in harness.published_encoded] == [here]


def test_status_says_that_a_link_has_another_version() -> None:
    with ModuleHarness(Link, {"robot": "red", "listen": []}) as harness:
        harness.module.node.meet("blue")
        older = MAGIC + bytes([VERSION - 1]) + b"beat"
        harness.module.node.take(ReceivedPacket("blue", older, b"", 0, is_datagram=True))
        harness.advance(1.1)
        versions = f"its link has version {VERSION - 1}, and this one {VERSION}"
        assert f"blue DOWN: {versions}; install the same Robbie-MP on both" in harness.module.status


@pytest.mark.parametrize("error", [NameTooLong("topic"), TooManyDeclarations("topics")])
def test_a_topic_that_the_bus_does_not_take_is_refused_and_ends_nothing(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> bool:
        raise error

    settings = {"robot": "red", "listen": [], "accept": {"blue": ["*"]}, "prefix_topics": True}
    with ModuleHarness(Link, settings) as harness:
        link = harness.module
        link.node.meet("blue")
        monkeypatch.setattr(link, "publish_encoded", refuse)
        name = ChannelId(String.type_name, 1, "x" * 96)
        message = Arrived("blue", 1, TrafficClass.RELIABLE, 0, name, String(data="x").encode(), 0, 0, False)
        assert link.on_arrived(message) is Fate.REFUSED


def test_order_to_a_robot_reaches_no_other_that_its_link_knows_instead() -> None:
    """A link that was started again sends what is for a robot that it has not met to all others."""
    settings = {"robot": "red", "listen": [], "accept": {"blue": ["*"]}, "prefix_topics": True}
    with ModuleHarness(Link, settings) as harness:
        link = harness.module
        link.node.meet("blue")
        fates = {}
        for topic in ("green/operator_request", "red/operator_request", "operator_request"):
            name = ChannelId(OperatorRequest.type_name, OperatorRequest.version, topic)
            hold = OperatorRequest(wish=OperatorRequest.HOLD).encode()
            one = Arrived("blue", 1, TrafficClass.URGENT, 0, name, hold, 0, 0, False)
            fates[topic] = link.on_arrived(one)
        assert [*fates.values()] == [Fate.REFUSED, Fate.PUBLISHED, Fate.PUBLISHED]
        assert len(link._orders) == 2


def test_operator_who_drives_one_of_several_robots_must_let_go_when_the_link_is_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = {"robot": "red", "listen": [], "accept": {"blue": ["DriveCommand */manual"]}}
    with ModuleHarness(Link, {**settings, "prefix_topics": True}) as harness:
        harness.advance(2.0)
        link = harness.module
        seen: list[tuple[str, bool]] = []
        peer = link.node.meet("blue")
        assert peer is not None
        now_ns = harness.clock.monotonic_ns()
        peer.clock.add(Exchange(now_ns, now_ns, now_ns, now_ns))
        monkeypatch.setattr(link.operators, "see_drive", lambda name, *_, moves: seen.append((name, moves)))
        command = DriveCommand(linear_m_per_s=0.5, valid_for=Duration.from_nanoseconds(220_000_000))
        name = ChannelId(DriveCommand.type_name, DriveCommand.version, "red/manual")
        data = command.encode()
        link.on_arrived(Arrived("blue", 1, TrafficClass.COMMAND, 0, name, data, now_ns, 0, False))
        assert seen == [("blue", True)]


def test_orders_and_stops_of_a_log_that_is_played_reach_no_robot_and_a_stop_by_hand_does() -> None:
    send = {"urgent": ["EmergencyStop */emergency_stop", "OperatorRequest */operator_request"]}
    settings = {"robot": "red", "listen": [], "robots": ["blue"], "send": send, "prefix_topics": True}
    with ModuleHarness(Link, settings) as harness:
        link = harness.module
        link.plays, link._log_source = True, "playback"
        offered: list[object] = []
        link.node.offer_to = lambda robot, message, now_ns: offered.append(  # type: ignore[method-assign]
            EmergencyStop.decode(message.data)
        )
        for engaged in (True, False):
            harness.send(EmergencyStop(engaged=engaged), topic="blue/emergency_stop", sender="playback")
        harness.send(OperatorRequest(), topic="blue/operator_request", sender="playback")
        assert (offered, link.withheld) == ([], 3)
        harness.send(EmergencyStop(engaged=True), topic="blue/emergency_stop", sender="operator")
        assert offered == [EmergencyStop(engaged=True)]
