"""The bridge beside a plain session of Zenoh that does what rmw_zenoh's design document says, and no more."""

import json
import socket
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import zenoh
import zenoh.ext
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_typestore

from robbie_mp import ModuleHarness, Reply, Request, SettingError
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.zenoh_side import LARGE_BYTES, ZenohSide
from robbie_mp.messages import (
    CancelNavigation,
    DriveCommand,
    Header,
    LaserScan,
    MapMetaData,
    NavigationCancelled,
    OccupancyGrid,
    Point,
    Pose,
    PoseStamped,
    String,
    Twist,
    Vector3,
    schema_text,
)
from robbie_mp.module.calls.peers import service_topic
from tests._support.robot import wait_until

POSE = (
    "geometry_msgs::msg::dds_::PoseStamped_/"
    "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
)
SCAN = (
    "sensor_msgs::msg::dds_::LaserScan_/"
    "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
)
GRID = (
    "nav_msgs::msg::dds_::OccupancyGrid_/"
    "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"
)
TWIST = (
    "geometry_msgs::msg::dds_::Twist_/RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
)
STRING = (
    "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
TRIGGER = (
    "std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
)
SET_BOOL = (
    "std_srvs::srv::dds_::SetBool_/RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"
)
ROS = get_typestore(Stores.ROS2_JAZZY)
SETTINGS = {
    "domain": 7,
    "node": "red",
    "parameters": "none",
    "send": {"LaserScan": "/scan best_effort depth=5", "OccupancyGrid": "/map latched depth=1"},
    "accept": {
        "/goal_pose": "PoseStamped goal",
        "/costs": "OccupancyGrid costs latched",
        "/cmd_vel": "Twist as DriveCommand ros",
    },
}
Bridge = ModuleHarness[Ros2Bridge]


class Triggered(Reply, name="std_srvs/srv/Trigger_Response"):
    success: bool
    message: str


class Trigger(Request[Triggered], name="std_srvs/srv/Trigger_Request"):
    pass


@pytest.fixture(scope="module", autouse=True)
def zenoh_has_started() -> None:
    """Zenoh keeps some descriptors until the process ends; have it open them before any test looks."""
    with network():
        pass


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port: int = taken.getsockname()[1]
    return port


@contextmanager
def session(**settings: object) -> Iterator[Any]:
    config = zenoh.Config()
    for path, value in {
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,
        "transport/shared_memory/enabled": False,
        **settings,
    }.items():
        config.insert_json5(path.replace("__", "/"), json.dumps(value))
    with zenoh.open(config) as opened:
        yield opened


class Node:
    """A node of ROS 2, as rmw_zenoh's design document describes it: a peer that knows a router."""

    def __init__(self, port: int, stack: ExitStack):
        own = {"listen__endpoints": ["tcp/127.0.0.1:0"], "connect__endpoints": [f"tcp/127.0.0.1:{port}"]}
        self.session = stack.enter_context(session(mode="peer", **own))
        self.sent = 0

    def publish(self, key: str, data: bytes) -> None:
        self.sent += 1
        attachment = struct.pack("<qqB16s", self.sent, time.time_ns(), 16, b"a node of ROS 2.")
        self.session.put(key, data, attachment=attachment)

    def publish_latched(self, key: str, data: bytes) -> None:
        self.sent += 1
        publisher = zenoh.ext.declare_advanced_publisher(
            self.session, key, cache=zenoh.ext.CacheConfig(1), publisher_detection=True
        )
        publisher.put(data, attachment=struct.pack("<qqB16s", 1, time.time_ns(), 16, b"another node ..."))
        self.kept = publisher

    def ask(self, key: str, data: bytes, number: int = 1) -> Any:
        """Send a request as rmw_zenoh's clients do, and return where its response comes."""
        return self.session.get(
            key,
            payload=data,
            attachment=struct.pack("<qqB16s", number, time.time_ns(), 16, b"a client of ROS."),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=20.0,
        )

    def tokens(self) -> list[str]:
        replies = self.session.liveliness().get("@ros2_lv/7/**", timeout=1.0)
        return sorted(str(one.ok.key_expr) for one in replies if one.ok is not None)


@contextmanager
def network(further: Mapping[str, object] = MappingProxyType({})) -> Iterator[tuple[Bridge, Node]]:
    """A bridge, a router that starts later, and a node."""
    port = free_port()
    with ExitStack() as stack:
        bridge = stack.enter_context(
            ModuleHarness(Ros2Bridge, {**SETTINGS, **further, "connect": [f"tcp/127.0.0.1:{port}"]})
        )
        bridge.send(
            LaserScan(ranges=np.ones(1, np.float32)), topic="laser"
        )  # nobody is there, and nothing waits
        stack.enter_context(session(mode="router", listen__endpoints=[f"tcp/127.0.0.1:{port}"]))
        node = Node(port, stack)
        wait_until(lambda: any("/NN/" in one for one in node.tokens()), 20.0)
        yield bridge, node


def until(bridge: Bridge, condition: Callable[[], object]) -> None:
    def step() -> bool:
        bridge.advance(0.02)
        return bool(condition())

    wait_until(step, 20.0)


def test_large_and_small_messages_of_a_topic_stay_in_order() -> None:
    with network() as (bridge, node):
        arrived: list[Any] = []
        node.session.declare_subscriber(f"7/scan/{SCAN}", arrived.append)
        scans = [LaserScan(ranges=np.ones(count, np.float32)) for count in (LARGE_BYTES, 1)]

        def are_both_there() -> bool:
            for scan in scans:
                bridge.send(scan, topic="laser")
            sizes = [len(one.payload) for one in list(arrived)]
            return min(sizes.count(len(scan.encode())) for scan in scans) > 2

        until(bridge, are_both_there)
        numbers = [struct.unpack_from("<q", one.attachment.to_bytes())[0] for one in list(arrived)]
        assert numbers == sorted(set(numbers))


def test_node_sees_the_robot_and_gets_its_messages() -> None:
    with network() as (bridge, node):
        grid = OccupancyGrid(header=Header(frame_id="map"), data=np.array([0, 100, -1], np.int8))
        bridge.send(grid, topic="map")
        scans: list[Any] = []
        node.session.declare_subscriber(f"7/scan/{SCAN}", scans.append)
        maps: list[Any] = []
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
        # It comes later than the map.
        kept = zenoh.ext.declare_advanced_subscriber(
            node.session, f"7/map/{GRID}", maps.append, history=history
        )
        scan = LaserScan(header=Header(frame_id="laser"), ranges=np.array([1.0, 2.5], np.float32))

        def is_there() -> bool:
            bridge.send(scan, topic="laser")
            return bool(scans and maps)

        until(bridge, is_there)
        read: Any = ROS.deserialize_cdr(scans[0].payload.to_bytes(), "sensor_msgs/msg/LaserScan")
        assert read.header.frame_id == "laser"
        assert list(read.ranges) == [1.0, 2.5]
        assert scans[0].payload.to_bytes() == scan.encode()
        decode = generate_dynamic("sensor_msgs/msg/LaserScan", schema_text(LaserScan))[
            "sensor_msgs/msg/LaserScan"
        ]
        again: Any = decode(scans[0].payload.to_bytes())  # mcap-ros2-support, too
        assert (again.header.frame_id, list(again.ranges)) == ("laser", [1.0, 2.5])
        assert maps[0].payload.to_bytes() == grid.encode()
        sequence, sent_ns, length, gid = struct.unpack("<qqB16s", scans[0].attachment.to_bytes())
        assert sequence >= 2
        assert abs(time.time_ns() - sent_ns) < 60e9
        assert length == 16
        assert gid != bytes(16)
        assert isinstance(bridge.module.side, ZenohSide)
        begin = f"@ros2_lv/7/{bridge.module.side.zenoh_id}/0"
        tokens = {
            f"{begin}/0/NN/%/%/red",
            f"{begin}/1/MS/%/%/red/%goal_pose/{POSE}/::,10:,:,:,,",
            f"{begin}/2/MS/%/%/red/%costs/{GRID}/:1:,10:,:,:,,",
            f"{begin}/3/MS/%/%/red/%cmd_vel/{TWIST}/::,10:,:,:,,",
            f"{begin}/4/SS/%/%/red/%emergency_stop%engage/{TRIGGER}/::,10:,:,:,,",
            f"{begin}/5/MP/%/%/red/%scan/{SCAN}/2::,5:,:,:,,",
            f"{begin}/6/MP/%/%/red/%map/{GRID}/:1:,1:,:,:,,",
        }
        wait_until(lambda: set(node.tokens()) == tokens, 10.0)
        kept.undeclare()


def test_robot_gets_a_nodes_messages_and_drives_for_a_while() -> None:
    with network() as (bridge, node):
        pose = PoseStamped(header=Header(frame_id="map"))
        info = MapMetaData(width=1, height=1, resolution=0.1)
        costs = OccupancyGrid(info=info, data=np.array([7], np.int8))
        node.publish_latched(f"7/costs/{GRID}", costs.encode())
        twist = Twist(linear=Vector3(x=0.4), angular=Vector3(z=0.1)).encode()

        def is_there() -> object:
            node.publish(f"7/goal_pose/{POSE}", pose.encode())
            node.publish(f"7/cmd_vel/{TWIST}", twist)
            topics = {one.topic for one in bridge.published_encoded}
            return topics == {"goal", "costs"} and bridge.published

        until(bridge, is_there)
        data = {one.topic: one.data for one in bridge.published_encoded}
        assert data == {"goal": pose.encode(), "costs": costs.encode()}
        assert bridge.latched(OccupancyGrid, "costs") == costs
        command = bridge.take(DriveCommand, "ros")[-1]
        assert (command.linear_m_per_s, command.angular_rad_per_s) == (0.4, 0.1)
        assert 0 < command.valid_for.nanoseconds <= 500_000_000


def test_frames_have_other_names_in_ros() -> None:
    with network({"frames": {"*": "red/{frame}"}}) as (bridge, node):
        scans: list[Any] = []
        node.session.declare_subscriber(f"7/scan/{SCAN}", scans.append)

        def is_there() -> object:
            bridge.send(LaserScan(header=Header(frame_id="laser")), topic="laser")
            for frame in ("red/map", "map"):  # the second means no frame of this robot
                node.publish(f"7/goal_pose/{POSE}", PoseStamped(header=Header(frame_id=frame)).encode())
            return scans and bridge.published_encoded and bridge.module.refused

        until(bridge, is_there)
        read: Any = ROS.deserialize_cdr(scans[0].payload.to_bytes(), "sensor_msgs/msg/LaserScan")
        assert read.header.frame_id == "red/laser"
        frames = {PoseStamped.decode(one.data).header.frame_id for one in bridge.published_encoded}
        assert frames == {"map"}


def test_late_node_gets_the_robots_model(tmp_path: Path) -> None:
    model = tmp_path / "robot.urdf"
    model.write_text('<robot name="red"/>')
    with network({"urdf": str(model), "namespace": "team"}) as (bridge, node):
        bridge.advance(0.02)
        got: list[Any] = []
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
        key = f"7/team/robot_description/{STRING}"
        kept = zenoh.ext.declare_advanced_subscriber(node.session, key, got.append, history=history)
        until(bridge, lambda: got)
        read: Any = ROS.deserialize_cdr(got[0].payload.to_bytes(), "std_msgs/msg/String")
        assert read.data == '<robot name="red"/>'
        kept.undeclare()


def test_wrong_bytes_and_other_types_are_counted_and_reach_nobody(caplog: pytest.LogCaptureFixture) -> None:
    with network() as (bridge, node):

        def is_there() -> bool:
            node.publish(f"7/goal_pose/{POSE}", b"\x00\x01\x00\x00garbage")
            node.publish(f"7/goal_pose/std_msgs::msg::dds_::String_/{TWIST[-71:]}", String().encode())
            node.publish(f"7/cmd_vel/{TWIST}", Twist(linear=Vector3(x=float("nan"))).encode())
            return bool(module.malformed and module.inbox.strangers >= 2 and module.ill_formed.total)

        module = bridge.module
        until(bridge, is_there)
        assert not bridge.published_encoded
        assert not bridge.published
        named = [one for one in caplog.messages if "was not asked for" in one]
        assert len(named) == 1
        assert "String_" in named[0]
        bridge.advance(1.1)
        assert "malformed" in module.status


def test_bridge_deals_only_with_the_nodes_that_match(caplog: pytest.LogCaptureFixture) -> None:
    port = free_port()
    router = [f"tcp/127.0.0.1:{port}"]
    other = {
        **SETTINGS,
        "connect": router,
        "accept": {},
        "send": {"PoseStamped": "/goal_pose"},
        "services": {"/save": "CancelNavigation"},
        "calls": {"/abort": "std_srvs/srv/Trigger"},
    }
    own = {
        **SETTINGS,
        "connect": router,
        "nodes": ["/mapping/*"],
        "services": {"/abort": "CancelNavigation"},
        "calls": {"/save": "std_srvs/srv/Trigger"},
    }
    with (
        session(mode="router", listen__endpoints=router),
        ModuleHarness(Ros2Bridge, {**other, "node": "slam", "namespace": "mapping"}) as slam,
        ModuleHarness(Ros2Bridge, own) as bridge,
    ):
        with ModuleHarness(Ros2Bridge, {**other, "node": "intruder"}) as intruder:

            def is_heard() -> bool:
                for one, x_m in ((slam, 1.0), (intruder, 2.0)):
                    one.advance(0.02)
                    one.send(PoseStamped(pose=Pose(position=Point(x=x_m))), topic="any")
                is_named = "a message on /goal_pose of /intruder is refused: see `nodes`" in caplog.text
                return bool(bridge.published_encoded) and is_named

            until(bridge, is_heard)
            poses = [PoseStamped.decode(one.data) for one in bridge.published_encoded]
            assert {one.pose.position.x for one in poses} == {1.0}
            assert called(intruder, bridge, "a request to /abort of /intruder is refused", caplog) == []
            assert called(bridge, intruder, "a response of /save of /intruder is refused", caplog) == []
        assert called(slam, bridge, "", caplog) == [True]
        assert True in called(bridge, slam, "", caplog)


def called(client: Bridge, server: Bridge, refusal: str, caplog: pytest.LogCaptureFixture) -> list[bool]:
    """Let a module beside one bridge call a service beside another; return `success` of its reply, if any."""
    client.bus.published.clear()
    client.send(Trigger(call=1), topic=service_topic(""), sender="mission")

    def is_done() -> bool:
        client.advance(0.02)
        for request in server.take(CancelNavigation, service_topic("")):
            server.reply(request, NavigationCancelled())
        return any(one.topic == "mission" for one in client.published) or (
            refusal != "" and refusal in caplog.text
        )

    until(server, is_done)
    return [one.message.success for one in client.published if hasattr(one.message, "success")]


def test_what_another_bridge_has_published_is_not_sent_back() -> None:
    with ModuleHarness(Ros2Bridge, {**SETTINGS, "connect": []}, name="ros2") as bridge:
        bridge.send(LaserScan(ranges=np.ones(1, np.float32)), topic="laser", sender="ros2")
        assert (bridge.module.sent, bridge.module.withheld) == (0, 1)


def test_bridge_that_has_ended_limits_no_log() -> None:
    with ModuleHarness(Ros2Bridge, {**SETTINGS, "connect": []}) as bridge:
        log = bridge.module.log
        assert log.filters
    assert not log.filters


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"node": "red robot"}, "a node cannot be called 'red robot'"),
        ({"send": {"LaserScan": "/1"}}, "'/1' is not a name"),
        ({"accept": {"/cmd_vel": "Twst"}}, "did you mean"),
        ({"namespace": "a b"}, "the namespace 'a b' is not a name"),
        ({"domain": 233}, "domain"),
        ({"nodes": ["/slam", "tester"]}, "begins with a slash, unlike 'tester'"),
        ({"frames": {"*": "red"}}, "expected a name with {frame}"),
    ],
)
def test_wrong_settings_are_explained(settings: dict[str, object], problem: str) -> None:
    with pytest.raises(SettingError, match=problem):
        ModuleHarness(Ros2Bridge, settings)
