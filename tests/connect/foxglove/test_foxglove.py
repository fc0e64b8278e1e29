"""What Foxglove's server gives and takes, seen by a client that was written from the specification."""

import logging
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.exceptions import ConnectionClosedError

from robbie_mp import ModuleHarness, SettingError
from robbie_mp.bus.observe import ChannelFigures, ModuleFigures
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.connect.bridge.surroundings import BridgeRun
from robbie_mp.connect.foxglove import door, server
from robbie_mp.connect.foxglove import module as services_foxglove
from robbie_mp.connect.foxglove.module import FoxgloveServer
from robbie_mp.connect.foxglove.server import ServiceCall
from robbie_mp.messages import (
    ControlState,
    DriveCommand,
    EmergencyStop,
    Header,
    Image,
    LaserScan,
    NavigateTo,
    PoseStamped,
    PoseWithCovarianceStamped,
    SettingChange,
    String,
    Twist,
    Vector3,
)
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.messages.plain import as_dict
from robbie_mp.messages.schema_parser import message_type_from_schema
from tests._support.robot import wait_until
from tests.connect.foxglove._support.foxglove_client import Client, connected

SETTINGS: dict[str, Any] = {
    "port": 0,
    "accept": {
        "/goal_pose": "PoseStamped goal",
        "/cmd_vel": "Twist as DriveCommand manual",
        "/gas": "nose_msgs/* gas",
    },
    "drive_valid_for_s": 0.4,
}


@pytest.fixture(scope="module", autouse=True)
def sdk_has_started() -> None:
    """The SDK keeps some descriptors until the process ends; have it open them before any test looks."""
    with ModuleHarness(FoxgloveServer, {"port": 0}) as harness, connected(harness.module.link):
        pass


@pytest.fixture
def harness(tmp_path: Path) -> Iterator[ModuleHarness[FoxgloveServer]]:
    (tmp_path / "robot.stl").write_bytes(b"solid")
    (tmp_path.parent / "outside").write_text("secret")
    with ModuleHarness(FoxgloveServer, SETTINGS | {"assets": {"robot": str(tmp_path)}}) as harness:
        yield harness


@pytest.fixture
def client(harness: ModuleHarness[FoxgloveServer]) -> Iterator[Client]:
    with connected(harness.module.link) as client:
        yield client


def tick_until(harness: ModuleHarness[FoxgloveServer], condition: Any) -> None:
    """Let the module's time pass until a condition holds."""

    def check() -> bool:
        harness.advance(0.05)
        return bool(condition())

    wait_until(check)


def test_client_decodes_what_a_module_published(
    harness: ModuleHarness[FoxgloveServer], client: Client
) -> None:
    scan = LaserScan(range_max=9.0, ranges=np.array([1.0, 2.5], np.float32))
    harness.send(scan, topic="laser/front")
    client.subscribe("/laser/front")
    tick_until(harness, harness.module.server.readers)
    harness.send(scan, topic="laser/front")
    client.until(lambda: client.data)
    assert client.data[0].data == scan.encode()
    seen = client.data[0].decode()
    assert (seen.range_max, list(seen.ranges)) == (9.0, [1.0, 2.5])


def test_large_messages_arrive_unchanged_beside_small_ones_and_a_client_that_reads_nothing(
    harness: ModuleHarness[FoxgloveServer], client: Client
) -> None:
    chance = np.random.default_rng(0)
    sizes = (3_000_000, 10, door.SMALL_BYTES, door.SMALL_BYTES + 1, door.PIECE_BYTES, 1_000_001)
    images = [Image(data=chance.integers(0, 256, size, np.uint8)) for size in sizes]
    harness.send(images[0], topic="camera")
    with connected(harness.module.link) as idle:
        for one in (client, idle):
            one.subscribe("/camera")
        tick_until(harness, lambda: any(len(one) == 2 for one in harness.module.server.readers().values()))
        for image in images:
            harness.send(image, topic="camera")
        client.until(lambda: len(client.data) == len(images))
    assert [one.data for one in client.data] == [image.encode() for image in images]
    assert max(one.messages for one in harness.module.door.passages.values()) >= len(images)


class Lookout:
    """Says which topics a run has, and which are latched."""

    def __init__(self) -> None:
        self.names: list[ChannelName] = []

    def latched(self) -> list[ChannelName]:
        return self.names

    def channels(self) -> list[ChannelFigures]:
        return [ChannelFigures(1, **name._asdict()) for name in self.names]

    def modules(self) -> list[ModuleFigures]:
        return []


def test_late_client_gets_what_came_before_its_topic_was_known_to_be_latched(
    harness: ModuleHarness[FoxgloveServer], client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    lookout, sign = Lookout(), String(data="this way")
    monkeypatch.setattr(harness.module, "_observer", lookout)
    harness.send(sign, topic="sign")
    client.subscribe("/sign")
    tick_until(harness, harness.module.server.readers)
    harness.send(sign, topic="sign")
    lookout.names.append(ChannelName(String.type_name, String.version, "sign"))
    harness.advance(2.0)
    client.until(lambda: client.data)
    server = harness.module.server
    readers = server.readers

    def subscribe_meanwhile() -> dict[int, set[int]]:
        known = readers()
        monkeypatch.setattr(server, "readers", readers)
        late.subscribe("/sign")
        wait_until(lambda: readers() != known)
        return known

    with connected(harness.module.link) as late:
        monkeypatch.setattr(server, "readers", subscribe_meanwhile)
        harness.advance(0.5)
        late.until(lambda: late.data)
        assert late.data[0].decode().data == "this way"


def test_two_types_on_one_topic_have_two_names(
    harness: ModuleHarness[FoxgloveServer], client: Client
) -> None:
    harness.send(String(data="a"), topic="status")
    harness.send(LaserScan(), topic="status")
    client.until(lambda: len(client.channels) == 2)
    assert set(client.channels) == {"/status", "/status/laser_scan"}


def test_a_type_that_a_bridge_has_learnt_is_shown(
    harness: ModuleHarness[FoxgloveServer], monkeypatch: pytest.MonkeyPatch
) -> None:
    name = ChannelName("nose_msgs/msg/Gas", 1, "gas")
    assert harness.module._schema(name) is None
    learnt = BridgeRun(KnownTypes([TypeDescription(name.type_name, 1, "uint16 ppm\n")]), frozenset())
    monkeypatch.setattr(BridgeRun, "of", lambda *_: learnt)
    assert harness.module._schema(name) == "uint16 ppm\n"


def test_accepted_message_is_published(harness: ModuleHarness[FoxgloveServer], client: Client) -> None:
    pose = PoseStamped()
    client.advertise(1, "/goal_pose", "geometry_msgs/msg/PoseStamped")
    client.publish(1, pose.encode())
    client.advertise(2, "/goal_pose", "geometry_msgs/PoseStamped", "json")
    client.publish(2, b'{"pose": {"position": {"x": 2}}}')
    tick_until(harness, lambda: len(harness.published) == 2)
    first, second = harness.take(PoseStamped, "goal")
    assert first.encode() == pose.encode()
    assert second.pose.position.x == 2.0


def test_each_goal_that_comes_while_the_robot_holds_is_refused_and_its_client_told() -> None:
    settings = {"port": 0, "accept": {"/goal": "PoseStamped as NavigateTo"}}
    with ModuleHarness(FoxgloveServer, settings) as harness, connected(harness.module.link) as client:
        harness.send(ControlState(mode=ControlState.HOLD, reason="somebody let go"), topic="control")
        client.advertise(1, "/goal", "geometry_msgs/msg/PoseStamped")
        for count in (1, 2):
            client.publish(1, PoseStamped().encode())
            tick_until(harness, lambda: harness.module.refused.total() == count)  # noqa: B023
        client.until(client.problems)
        assert "the robot is in HOLD: somebody let go; order it to go on" in client.problems()[0]
        assert not harness.take(NavigateTo)
        harness.send(ControlState(), topic="control")

        def is_taken() -> bool:  # not before pings tell how far away the client is
            client.publish(1, PoseStamped().encode())
            return bool(harness.take(NavigateTo))

        tick_until(harness, is_taken)


@pytest.mark.parametrize(
    ("topic", "schema", "data", "problem"),
    [
        ("/goal", "geometry_msgs/msg/PoseStamped", PoseStamped().encode(), "`accept` does not allow it"),
        ("/goal_pose", "std_msgs/msg/String", String().encode(), "`accept` does not allow it"),
        ("/goal_pose", "geometry_msgs/msg/PoseStamped", b"\x00\x01\x00\x00\x07", "PoseStamped"),
        ("/goal_pose", "geometry_msgs/msg/PoseStamped", b"", "PoseStamped"),
        ("/cmd_vel", "geometry_msgs/msg/Twist", Twist(linear=Vector3(x=np.nan)).encode(), "a finite number"),
    ],
)
def test_wrong_message_is_counted_and_explained(
    harness: ModuleHarness[FoxgloveServer],
    client: Client,
    topic: str,
    schema: str,
    data: bytes,
    problem: str,
) -> None:
    client.advertise(1, topic, schema)
    client.publish(1, data)
    tick_until(harness, lambda: harness.module.refused.total() == 1)
    client.until(client.problems)
    assert problem in client.problems()[0]
    assert not harness.published


GAS = "float32[] ppm\nReading[2] readings\n===\nMSG: nose_msgs/Reading\nstring name\nuint8 level\n"
"""A type that no module of a robot declares."""


def gas_of_rosbags() -> bytes:
    """A message of that type, as another implementation encodes it."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(GAS.replace("===", "=" * 80), "nose_msgs/msg/Gas"))
    kinds = store.types
    readings = [kinds["nose_msgs/msg/Reading"](name=name, level=2) for name in ("CO", "CH4")]
    gas = kinds["nose_msgs/msg/Gas"](ppm=np.array([1.5, 2.5], np.float32), readings=readings)
    return bytes(store.serialize_cdr(gas, "nose_msgs/msg/Gas"))


@pytest.mark.parametrize("name", ["nose_msgs/msg/Gas", "nose_msgs/Gas"])
def test_a_type_that_only_the_client_knows_is_published_as_that_type(
    harness: ModuleHarness[FoxgloveServer], client: Client, name: str
) -> None:
    client.advertise(1, "/gas", name, schemaEncoding="ros2msg", schema=GAS)
    client.publish(1, gas_of_rosbags())
    client.advertise(2, "/gas", name, "json", schemaEncoding="ros2msg", schema=GAS)
    client.publish(2, b'{"ppm": [3]}')
    tick_until(harness, lambda: len(harness.published_encoded) == 2)
    first, second = harness.published_encoded
    assert (first.type_name, first.version, first.topic) == ("nose_msgs/msg/Gas", 1, "gas")
    assert first.data == gas_of_rosbags()
    kind = message_type_from_schema("nose_msgs/msg/Gas", GAS)
    assert list(as_dict(kind.decode(second.data))["ppm"]) == [3.0]
    assert not harness.module.refused


@pytest.mark.parametrize(
    ("name", "schema", "data", "problem"),
    [
        ("nose_msgs/msg/Gas", {}, b"", "sends none"),
        ("nose_msgs/msg/Gas", {"schemaEncoding": "protobuf", "schema": ""}, b"", "one in protobuf"),
        ("nose_msgs/msg/Gas", {"schemaEncoding": "ros2msg", "schema": "no field"}, b"", "nose_msgs"),
        ("nose_msgs/msg/Gas", {"schemaEncoding": "ros2msg", "schema": "Gas more"}, b"", "no definition of"),
        (
            "nose_msgs/msg/Gas",
            {"schemaEncoding": "ros2msg", "schema": GAS},
            b"\0\1\0\0\7",
            "nose_msgs/msg/Gas",
        ),
        ("other_msgs/msg/Gas", {"schemaEncoding": "ros2msg", "schema": GAS}, b"", "does not allow"),
    ],
)
def test_a_client_whose_type_cannot_be_learnt_is_refused_and_told_once(
    harness: ModuleHarness[FoxgloveServer],
    client: Client,
    name: str,
    schema: dict[str, str],
    data: bytes,
    problem: str,
) -> None:
    client.advertise(1, "/gas", name, **schema)
    for _ in range(3):
        client.publish(1, data)
    tick_until(harness, lambda: harness.module.refused.total() == 3)
    client.until(client.problems)
    assert len(client.problems()) == 1
    assert problem in client.problems()[0]
    assert not harness.published_encoded


def test_schemas_of_clients_are_limited(
    harness: ModuleHarness[FoxgloveServer], client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "MAX_SCHEMA_BYTES", len(GAS) + 10)
    monkeypatch.setattr(services_foxglove, "MAX_FOREIGN", 2)
    for number, schema in ((1, GAS), (2, GAS), (3, "uint8 x")):
        client.advertise(number, "/gas", f"nose_msgs/Gas{number}", schemaEncoding="ros2msg", schema=schema)
        client.publish(number, gas_of_rosbags())
    tick_until(harness, lambda: harness.module.refused.total() == 2)
    assert [one.type_name for one in harness.published_encoded] == ["nose_msgs/msg/Gas1"]
    assert any("which is the limit" in problem for problem in harness.module.refused)


def test_velocity_becomes_a_drive_command_that_expires(
    harness: ModuleHarness[FoxgloveServer], client: Client
) -> None:
    client.advertise(1, "/cmd_vel", "geometry_msgs/msg/Twist")
    (passage,) = harness.module.door.passages.values()
    wait_until(lambda: passage.greatest_age_s < 0.2)
    client.publish(1, Twist(linear=Vector3(x=0.3), angular=Vector3(z=-0.2)).encode())
    tick_until(harness, lambda: harness.published)
    (command,) = harness.take(DriveCommand, "manual")
    assert (command.linear_m_per_s, command.angular_rad_per_s) == (0.3, -0.2)
    assert 0 < command.valid_for.nanoseconds <= 400_000_000


def test_messages_beyond_the_queue_are_counted(
    harness: ModuleHarness[FoxgloveServer], client: Client
) -> None:
    client.advertise(1, "/goal_pose", "geometry_msgs/msg/PoseStamped")
    for _ in range(300):
        client.publish(1, PoseStamped().encode())
    wait_until(lambda: harness.module.server.overflowed == 300 - 256)
    harness.advance(0.05)
    assert len(harness.take(PoseStamped)) == 256


@pytest.mark.parametrize(
    ("service", "request_data", "engaged"),
    [
        ("/emergency_stop", b"\x00\x01\x00\x00\x01", True),
        ("/emergency_stop", b"\x00\x01\x00\x00\x00", False),
        ("/emergency_stop/engage", b"\x00\x01\x00\x00\x00", True),
    ],
)
def test_service_stops_the_robot(
    harness: ModuleHarness[FoxgloveServer], client: Client, service: str, request_data: bytes, engaged: bool
) -> None:
    client.call(service, request_data, call=7)
    tick_until(harness, lambda: harness.published)
    client.until(lambda: client.responses)
    response = client.responses[7]
    (stop,) = harness.take(EmergencyStop, "emergency_stop")
    assert stop.engaged is engaged
    assert response[4] == 1
    assert String.decode(response[:4] + response[8:]).data.startswith("sent")


def test_release_that_has_waited_does_nothing(harness: ModuleHarness[FoxgloveServer]) -> None:
    harness.advance(5.0)
    call = ServiceCall("/emergency_stop", b"\x00\x01\x00\x00\x00", harness.clock.monotonic_ns())
    harness.advance(1.0)
    harness.module._serve(call)
    assert not harness.take(EmergencyStop)
    response = call.wait()
    assert response[4] == 0
    assert "has waited 1.0 s" in String.decode(response[:4] + response[8:]).data
    stop = ServiceCall("/emergency_stop", b"\x00\x01\x00\x00\x01", 0)
    harness.module._serve(stop)
    assert [one.engaged for one in harness.take(EmergencyStop)] == [True]


def test_client_reads_only_files_of_the_profiles_folders(
    harness: ModuleHarness[FoxgloveServer], client: Client
) -> None:
    assert client.fetch("package://robot/robot.stl", 1) == b"solid"
    for number, uri in enumerate(
        [
            "package://robot/../outside",
            "package://robot/%2e%2e/outside",
            "file:///etc/passwd",
            "package://x/y",
        ]
    ):
        assert client.fetch(uri, number + 2) is None


def test_files_are_refused_at_once_where_the_profile_has_none() -> None:
    with ModuleHarness(FoxgloveServer, SETTINGS) as harness, connected(harness.module.link) as client:
        assert client.fetch("package://robot/robot.stl", 1) is None
    assert "sets no `assets`" in client.asset_errors[1]


def test_frames_have_other_names_for_clients() -> None:
    settings = SETTINGS | {"frames": {"*": "red/{frame}"}}
    with ModuleHarness(FoxgloveServer, settings) as harness, connected(harness.module.link) as client:
        harness.send(LaserScan(header=Header(frame_id="laser")), topic="front")
        client.subscribe("/front")
        tick_until(harness, lambda: harness.module._readers)
        harness.send(LaserScan(header=Header(frame_id="laser")), topic="front")
        client.until(lambda: client.data)
        assert LaserScan.decode(client.data[0].data).header.frame_id == "red/laser"
        client.advertise(1, "/goal_pose", "geometry_msgs/msg/PoseStamped")
        for frame in ("red/map", "map"):
            client.publish(1, PoseStamped(header=Header(frame_id=frame)).encode())
        tick_until(harness, lambda: harness.module.refused)
        (goal,) = harness.take(PoseStamped, "goal")
        assert goal.header.frame_id == "map"


@pytest.mark.parametrize("query", ["", "?token=", "?token=wrong", "?TOKEN={token}"])
def test_without_the_token_nobody_comes_in(
    harness: ModuleHarness[FoxgloveServer], query: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door, "WRONG_TOKEN_PAUSE_S", 0.0)
    module = harness.module
    token = module.link.partition("token=")[2]
    with (
        connected(module.address + query.format(token=token)) as client,
        pytest.raises(ConnectionClosedError, match="1008"),
    ):
        client.until(lambda: False)
    assert client.problems() == [door.WRONG_TOKEN]
    assert module.door.refused == 1


def test_a_program_that_speaks_only_http_gets_a_status(
    harness: ModuleHarness[FoxgloveServer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door, "WRONG_TOKEN_PAUSE_S", 0.0)
    address = harness.module.address.replace("ws://", "http://")
    with pytest.raises(HTTPError, match="401") as refused, urlopen(address, timeout=5.0):
        pass
    refused.value.close()


def test_who_finds_the_inner_port_gets_no_message_and_can_do_nothing(
    harness: ModuleHarness[FoxgloveServer],
) -> None:
    module = harness.module
    harness.send(String(data="secret"), topic="diary")
    with connected(f"ws://127.0.0.1:{module.server.port}/") as stranger:
        stranger.advertise(1, "/goal_pose", "geometry_msgs/msg/PoseStamped")
        stranger.publish(1, PoseStamped().encode())
        stranger.subscribe("/diary")
        wait_until(lambda: module.server.is_breached)
        harness.send(String(data="secret"), topic="diary")
        harness.advance(0.1)
    assert module.strangers == 1
    assert not harness.published
    assert not stranger.data
    with connected(module.link) as client:
        client.subscribe("/diary")
        tick_until(harness, module.server.readers)
        harness.send(String(data="open"), topic="diary")
        client.until(lambda: client.data)
        assert client.data[0].decode().data == "open"


def test_only_so_many_clients_come_in() -> None:
    with (
        ModuleHarness(FoxgloveServer, {"port": 0, "max_clients": 1}) as harness,
        connected(harness.module.link),
        connected(harness.module.link) as second,
    ):
        with pytest.raises(ConnectionClosedError, match="1008"):
            second.until(lambda: False)
        assert "max_clients" in second.problems()[0]


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"host": "0.0.0.0"}, "can be reached from other machines"),
        ({"send": {"Image camera front": ""}}, "expected a type"),
        ({"accept": {"/x": "NoSuchType"}}, "NoSuchType"),
        ({"accept": {"/x": "String as DriveCommand manual"}}, "can become a DriveCommand"),
    ],
)
def test_wrong_settings_are_explained(settings: dict[str, object], problem: str) -> None:
    with pytest.raises(SettingError, match=problem), ModuleHarness(FoxgloveServer, settings):
        pass


def test_port_in_use_is_explained() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        settings = {"port": taken.getsockname()[1]}
        closed = pytest.raises(door.DoorClosed, match="set another host or port")
        with closed, ModuleHarness(FoxgloveServer, settings):
            pass


def test_apps_take_the_robot_for_one_of_ros_2(client: Client) -> None:
    client.until(lambda: client.told)
    assert client.told[0]["metadata"]["ROS_DISTRO"] == "jazzy"
    assert client.told[0]["metadata"]["fg-library"]


def test_a_pose_with_a_covariance_becomes_a_pose() -> None:
    accept = {"/initialpose": "PoseWithCovarianceStamped as PoseStamped initial_pose"}
    settings = {"port": 0, "accept": accept}
    with ModuleHarness(FoxgloveServer, settings) as harness, connected(harness.module.link) as client:
        client.advertise(1, "/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped")
        client.publish(1, PoseWithCovarianceStamped(header=Header(frame_id="map")).encode())
        tick_until(harness, lambda: harness.published)
        (pose,) = harness.take(PoseStamped, "initial_pose")
        assert pose.header.frame_id == "map"


def test_a_kept_token_outlives_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    tokens = []
    for _ in range(2):
        with ModuleHarness(FoxgloveServer, {"port": 0, "keep_token": True}) as harness:
            tokens.append(harness.module.link.partition("token=")[2])
    assert tokens[0] == tokens[1]
    assert (tmp_path / "robbie" / services_foxglove.TOKEN_FILE).stat().st_mode & 0o077 == 0


class PlayedClock:
    """The clock of a run that is played."""

    has_begun = True

    def __init__(self) -> None:
        self.jumps, self.ns = 0, 5_000_000_000

    def now_ns(self) -> int:
        return self.ns

    def close(self) -> None:
        pass


def test_clients_get_the_time_of_a_playback_and_what_is_latched_after_a_jump(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    around = replace(BridgeRun.of("", "foxglove", ""), has_own_clock=True)
    monkeypatch.setattr(BridgeRun, "of", lambda *_: around)
    lookout, clock = Lookout(), PlayedClock()
    lookout.names.append(ChannelName(String.type_name, String.version, "sign"))
    with ModuleHarness(FoxgloveServer, SETTINGS) as harness:
        monkeypatch.setattr(harness.module, "_observer", lookout)
        with monkeypatch.context() as patch, connected(harness.module.link) as client:
            patch.setattr(harness.module, "_run_clock", clock)
            harness.advance(0.5)
            client.subscribe("/sign")
            tick_until(harness, harness.module.server.readers)
            harness.send(String(data="this way"), topic="sign")
            client.until(lambda: client.data and client.times_ns)
            clock.ns, clock.jumps = 1_000_000_000, 1
            harness.advance(0.05)
            client.until(lambda: client.times_ns[-1] == clock.ns)
            harness.advance(0.05)
            client.until(lambda: client.data[-1].time_ns == clock.ns)
        monkeypatch.setattr(harness.module, "_observer", None)
    assert client.data[-1].data == client.data[0].data


def test_a_client_that_comes_back_gets_what_is_latched(
    harness: ModuleHarness[FoxgloveServer], client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    lookout = Lookout()
    lookout.names.append(ChannelName(String.type_name, String.version, "sign"))
    with monkeypatch.context() as patch:
        patch.setattr(harness.module, "_observer", lookout)
        harness.send(String(data="this way"), topic="sign")
        harness.advance(0.5)
        client.subscribe("/sign")
        tick_until(harness, harness.module.server.readers)
        harness.send(String(data="this way"), topic="sign")
        client.until(lambda: len(client.data) == 1)
        client.send("unsubscribe", subscriptionIds=[1])
        client.subscribe("/sign")
        wait_until(lambda: bool(harness.module.server._new_readers))
        harness.advance(0.05)
        client.until(lambda: len(client.data) == 2)


def test_a_slow_client_alone_is_told_what_it_loses(
    harness: ModuleHarness[FoxgloveServer], client: Client
) -> None:
    module = harness.module
    harness.send(String(data="a"), topic="diary")
    with connected(module.link) as other:
        for one in (client, other):
            one.subscribe("/diary")
        tick_until(harness, lambda: any(len(one) == 2 for one in module.server.readers().values()))
        harness.send(String(data="a"), topic="diary")
        module._offered[1] += 999
        module._look()
        harness.send(String(data="b"), topic="diary")
        client.until(client.problems)
        other.until(lambda: other.data)
    assert "968 messages" in client.problems()[0]
    assert "/diary" in client.problems()[0]
    assert not other.problems()


def test_a_setting_without_a_value_is_null_both_ways(
    harness: ModuleHarness[FoxgloveServer], monkeypatch: pytest.MonkeyPatch
) -> None:
    class OneSetting:
        def read_changeable(self) -> dict[str, dict[str, object]]:
            return {"limit": {"value": None}}

    assert services_foxglove._plain({"a": [None, 1]}) == {"a": ["null", 1]}
    monkeypatch.setattr(harness.module, "_files", {"base": OneSetting()})
    harness.module._change(server.ParameterWish("base.limit", "null"))
    (change,) = harness.take(SettingChange)
    assert change.value == "null"
    monkeypatch.undo()


def test_an_app_that_closes_is_no_error(harness: ModuleHarness[FoxgloveServer]) -> None:
    logger = logging.getLogger(server.CLIENT_LOGGER)
    text = "%s from client 127.0.0.1:1: Connection reset without closing handshake"

    def line(what: str) -> logging.LogRecord:
        return logging.LogRecord(logger.name, logging.ERROR, "", 0, text, (what,), None)

    assert not logger.filter(line("Error receiving"))
    assert logger.filter(line("Damaged frame"))
