"""The service moves the graph according to messages and publishes it; a listener follows it."""

import logging
import math
import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import Header, Message, Module, ModuleHarness, SettingError, Time
from robbie_mp.messages import (
    JointState,
    Odometry,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    SceneGraphState,
    TFMessage,
    TimeJump,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_mp.module.harness import NotSubscribed
from robbie_mp.scene import (
    Disconnected,
    NeverPlaced,
    RigidTransform,
    SceneGraphListener,
    TooNew,
    TooOld,
    UnknownNode,
)
from robbie_mp.scene.module import SceneGraphService

ROBOT = """\
nodes:
  map:
  odom: {parent: map, joint: {type: floating}}
  base_link: {parent: odom, joint: {type: floating}}
  laser: {parent: base_link, translation: [0.2, 0, 0.3]}
  pan: {parent: base_link, translation: [0, 0, 1], joint: {type: revolute, name: pan_joint, limits: [-1, 1]}}
  shade:
    parent: pan
    joint: {type: prismatic, name: shade_joint, mimic: {joint: pan_joint, multiplier: 0.1}}
"""
SECOND = 10**9


class Listening(Module):
    """A module that uses the scene graph."""

    def setup(self) -> None:
        self.scene = SceneGraphListener(self, history_s=100.0)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    made = tmp_path / "robot.yaml"
    made.write_text(ROBOT)
    return made


def serve(file: Path, restored: object = None) -> ModuleHarness[SceneGraphService]:
    return ModuleHarness(SceneGraphService, {"file": str(file)}, restored=restored)


def header(at_s: float, frame: str = "") -> Header:
    return Header(stamp=Time.from_nanoseconds(round(at_s * 1e9)), frame_id=frame)


def planar(x: float, y: float, yaw: float) -> Pose:
    return Pose(position=Point(x=x, y=y), orientation=Quaternion.from_yaw(yaw))


def odometry(at_s: float, x: float, yaw: float = 0.0, child: str = "base_link") -> Odometry:
    pose = PoseWithCovariance(pose=planar(x, 0.0, yaw))
    return Odometry(header=header(at_s, "odom"), child_frame_id=child, pose=pose)


def map_pose(at_s: float, x: float, y: float, yaw: float) -> PoseStamped:
    return PoseStamped(header=header(at_s, "map"), pose=planar(x, y, yaw))


def joints(at_s: float, **positions: float) -> JointState:
    return JointState(header=header(at_s), name=list(positions), position=np.array(list(positions.values())))


def told(harness: ModuleHarness[SceneGraphService]) -> list[tuple[str, str, float]]:
    """Parent, child and time of the transforms that have been published on `tf`."""
    return [
        (each.header.frame_id, each.child_frame_id, each.header.stamp.nanoseconds / 1e9)
        for message in harness.take(TFMessage, "tf")
        for each in message.transforms
    ]


def pass_on(harness: ModuleHarness[SceneGraphService], listening: ModuleHarness[Listening]) -> None:
    for entry in harness.published:
        with suppress(NotSubscribed):
            listening.send(entry.message, topic=entry.topic)
    harness.published.clear()


def test_changes_are_published_at_once_and_fixed_transforms_once_for_all_who_come_later(file: Path) -> None:
    with serve(file) as harness:
        harness.advance(0.0)
        (fixed,) = harness.take(TFMessage, "tf_static")
        assert [(each.header.frame_id, each.child_frame_id) for each in fixed.transforms] == [
            ("base_link", "laser")
        ]
        harness.send(odometry(1.0, 2.0), topic="odom")
        assert told(harness) == [("odom", "base_link", 1.0)]
        harness.advance(0.5)
        harness.send(joints(1.5, pan_joint=0.5), topic="arm")
        assert told(harness) == [("base_link", "pan", 1.5), ("pan", "shade", 1.5)]
        harness.advance(0.2)
        state = harness.take(SceneGraphState)[-1]
        harness.advance(1.5)
        assert not harness.published, "nothing has changed"
        assert harness.latched(TFMessage, "tf_static") == fixed
        assert harness.latched(SceneGraphState) == state
        assert harness.latched(TFMessage, "tf") is None


def test_fast_changes_share_messages_and_none_is_omitted(file: Path) -> None:
    with serve(file) as harness:
        for step in range(1, 101):
            harness.send(odometry(step / 1000, step), topic="odom")
            harness.advance(0.001)
        harness.advance(0.1)
        messages = [entry for entry in harness.published if entry.topic == "tf"]
        assert 5 <= len(messages) <= 7
        assert told(harness) == [("odom", "base_link", step / 1000) for step in range(1, 101)]
        assert 2 <= len(harness.take(SceneGraphState)) <= 4


def test_map_pose_moves_the_odometry_frame(file: Path) -> None:
    with serve(file) as harness, ModuleHarness(Listening) as listening:
        harness.send(odometry(1.0, 1.0, math.pi / 2), topic="odom")
        harness.send(odometry(2.0, 3.0, math.pi / 2), topic="odom")
        harness.send(map_pose(2.0, 10.0, 5.0, 0.0), topic="map_pose")
        harness.advance(0.1)
        pass_on(harness, listening)
        scene = listening.module.scene
        assert scene.pose("map", "base_link", 2 * SECOND).translation == pytest.approx([10.0, 5.0, 0.0])
        assert scene.pose("map", "laser").translation == pytest.approx([10.2, 5.0, 0.3])
        assert scene.pose("map", "odom").yaw == pytest.approx(-math.pi / 2)
        # The correction goes on to hold while the robot drives on.
        harness.send(odometry(3.0, 4.0, math.pi / 2), topic="odom")
        pass_on(harness, listening)
        assert scene.pose("map", "base_link", 3 * SECOND).translation == pytest.approx([10.0, 4.0, 0.0])


def test_map_pose_may_arrive_early_or_late(file: Path) -> None:
    with serve(file) as harness:
        graph = harness.module.graph
        harness.send(map_pose(1.5, 7.0, 0.0, 0.0), topic="map_pose")
        harness.send(odometry(1.0, 1.0), topic="odom")
        with pytest.raises(NeverPlaced):
            graph.pose("map", "base_link")
        harness.send(odometry(2.0, 2.0), topic="odom")
        assert graph.pose("map", "odom").x == pytest.approx(5.5)
        harness.send(odometry(3.0, 3.0), topic="odom")
        harness.advance(0.1)
        harness.send(map_pose(2.5, 8.0, 0.0, 0.0), topic="map_pose")
        assert graph.pose("map", "base_link", 3 * SECOND).x == pytest.approx(8.5)


def test_each_robot_has_its_own_topics_and_nodes(file: Path) -> None:
    world = file.with_name("world.yaml")
    world.write_text(
        "nodes: {world: }\n"
        "include:\n"
        "  - {file: robot.yaml, prefix: red/, parent: world}\n"
        "  - {file: robot.yaml, prefix: blue/, parent: world, translation: [0, 10, 0]}\n"
    )
    with serve(world) as harness:
        for prefix, x in (("red/", 1.0), ("blue/", 2.0)):
            harness.send(odometry(1.0, 0.0), topic=f"{prefix}odom")
            harness.send(map_pose(1.0, x, 0.0, 0.0), topic=f"{prefix}map_pose")
        harness.send(joints(1.0, pan_joint=0.3), topic="blue/joint_states")
        graph = harness.module.graph
        assert graph.pose("red/base_link", "blue/laser", SECOND).translation == pytest.approx([1.2, 10, 0.3])
        assert graph.pose("blue/base_link", "blue/pan").yaw == pytest.approx(0.3)
        with pytest.raises(NeverPlaced):
            graph.pose("red/base_link", "red/pan")


def test_a_placed_map_brings_another_robot_into_the_scene_graph(file: Path) -> None:
    team = file.with_name("team.yaml")
    team.write_text(
        ROBOT + "include:\n  - {file: robot.yaml, prefix: blue/, parent: map, joint: {type: floating}}\n"
    )
    with serve(team) as harness:
        harness.send(odometry(1.0, 0.0), topic="odom")
        harness.send(map_pose(1.0, 1.0, 0.0, 0.0), topic="map_pose")
        blue = Odometry(header=header(1.0, "blue/odom"), child_frame_id="blue/base_link")
        harness.send(blue, topic="blue/odom")
        harness.send(PoseStamped(header=header(1.0, "blue/map")), topic="blue/map_pose")
        graph = harness.module.graph
        with pytest.raises(NeverPlaced):
            graph.pose("base_link", "blue/laser")
        harness.send(transforms(1.0, ("map", "blue/map", 5.0)), topic="placed")
        assert graph.pose("base_link", "blue/laser").x == pytest.approx(4.2)


def test_state_has_every_node(file: Path) -> None:
    with serve(file) as harness:
        harness.send(odometry(1.0, 2.0), topic="odom")
        harness.send(joints(1.5, pan_joint=0.5))
        harness.advance(0.0)
        (state,) = harness.take(SceneGraphState)
        nodes = {node.name: node for node in state.nodes}
        assert list(nodes) == ["map", "odom", "base_link", "laser", "pan", "shade"]
        assert state.header.stamp.nanoseconds == 1.5 * SECOND
        assert not nodes["odom"].is_placed and nodes["map"].is_placed
        assert nodes["base_link"].transform.translation.x == 2.0
        assert (nodes["pan"].type, nodes["pan"].joint, nodes["pan"].parent) == (
            "revolute",
            "pan_joint",
            "base_link",
        )
        assert nodes["shade"].transform.translation.z == pytest.approx(0.05)


def test_restarted_service_keeps_the_correction(file: Path) -> None:
    with serve(file) as harness:
        harness.send(odometry(1.0, 1.0), topic="odom")
        harness.send(map_pose(1.0, 5.0, 0.0, 0.0), topic="map_pose")
        kept = harness.checkpoint
    with serve(file, kept) as harness:
        harness.send(odometry(2.0, 2.0), topic="odom")
        harness.advance(0.1)
        assert ("map", "odom", 2.0) in told(harness)
        assert harness.module.graph.pose("map", "base_link").x == pytest.approx(6.0)


def test_jump_of_time_clears_all_positions(file: Path) -> None:
    with serve(file) as harness, ModuleHarness(Listening) as listening:
        harness.send(odometry(100.0, 1.0), topic="odom")
        harness.send(map_pose(100.0, 5.0, 0.0, 0.0), topic="map_pose")
        pass_on(harness, listening)
        for each in (harness, listening):
            each.send(TimeJump())
        assert harness.checkpoint == {}
        harness.send(odometry(1.0, 2.0), topic="odom")
        harness.advance(0.1)
        pass_on(harness, listening)
        scene = listening.module.scene
        assert scene.pose("odom", "base_link").x == 2.0
        with pytest.raises((NeverPlaced, UnknownNode)):
            scene.pose("map", "base_link")


def test_odometry_with_a_future_stamp_does_not_block_the_robot_for_ever(file: Path) -> None:
    with serve(file) as harness:
        harness.send(odometry(1.0, 1.0), topic="odom")
        harness.send(map_pose(1.0, 5.0, 0.0, 0.0), topic="map_pose")
        harness.send(odometry(9999.0, 1.0), topic="odom")
        for step in range(40):
            harness.send(odometry(2.0 + step, 2.0), topic="odom")
            harness.send(map_pose(2.0 + step, 7.0, 0.0, 0.0), topic="map_pose")
        assert harness.module.graph.pose("map", "base_link", 41 * SECOND).x == pytest.approx(7.0)


@pytest.mark.parametrize(
    ("message", "topic", "said"),
    [
        (
            odometry(1.0, 0.0, child="base"),
            "odom",
            r"odometry on 'odom' is ignored: there is no node 'base'; did",
        ),
        (odometry(1.0, 0.0, child="laser"), "odom", "the parent of node 'laser' is 'base_link', not 'odom'"),
        (joints(1.0, pan_join=1.0), "", "'pan_join' is ignored: there is no joint 'pan_join'; did you mean"),
        (joints(1.0, pan_joint=3.0), "", r"joint 'pan_joint': is at 3, beyond its limits \(-1.0, 1.0\)"),
        (
            PoseStamped(header=header(1.0, "mapp")),
            "map_pose",
            "a map pose on 'map_pose' is ignored: there is no",
        ),
        (
            TFMessage(transforms=[TransformStamped(header=header(1.0, "map"), child_frame_id="laser")]),
            "placed",
            "the place of 'laser' on 'placed' is ignored: the parent of node 'laser' is 'base_link'",
        ),
        (PoseStamped(header=header(1.0, "laser")), "map_pose", "'base_link' is not below 'laser'"),
        (PoseStamped(header=header(-60.0, "map")), "map_pose", "is known from 1.000000 s on; asked for 61"),
    ],
)
def test_message_that_cannot_be_applied_is_logged_once_and_counted(
    file: Path, caplog: pytest.LogCaptureFixture, message: Message, topic: str, said: str
) -> None:
    with serve(file) as harness, caplog.at_level(logging.WARNING):
        harness.send(odometry(1.0, 0.0), topic="odom")
        harness.send(message, topic=topic)
        harness.send(message, topic=topic)
        (record,) = caplog.records
        assert re.search(said, record.getMessage())
        harness.advance(0.1)
        assert ("2 ignored" in harness.module.status) == ("beyond" not in said)


def test_invalid_scene_files_are_reported_before_anything_starts(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("nodes:\n  a: {parent: b}\n")
    with pytest.raises(SettingError, match=r"robot.yaml:2: the parent of node 'a', 'b', does not exist"):
        serve(file)


def transforms(at_s: float, *links: tuple[str, str, float]) -> TFMessage:
    return TFMessage(
        transforms=[
            TransformStamped(
                header=header(at_s, parent),
                child_frame_id=child,
                transform=Transform(translation=Vector3(x=x)),
            )
            for parent, child, x in links
        ]
    )


def test_listener_builds_the_tree_from_messages_in_any_order() -> None:
    with ModuleHarness(Listening) as harness:
        scene = harness.module.scene
        harness.send(transforms(0.0, ("camera", "lens", 0.01), ("base", "camera", 0.1)), topic="tf_static")
        harness.send(transforms(1.0, ("odom", "base", 1.0)), topic="tf")
        harness.send(transforms(2.0, ("odom", "base", 3.0), ("map", "odom", 10.0)), topic="tf")
        harness.send(transforms(2.0, ("odom", "base", 99.0)), topic="ideal/tf")
        assert scene.pose("odom", "lens", SECOND * 3 // 2).x == pytest.approx(2.11)
        camera = scene.pose("map", "camera")
        assert camera.x == pytest.approx(13.1)
        assert camera._replace(x=0.0) == RigidTransform()
        with pytest.raises(TooNew):
            scene.pose("odom", "lens", 3 * SECOND)
        with pytest.raises(TooOld):
            scene.pose("odom", "lens", 0)
        with pytest.raises(UnknownNode, match="no node 'lense'; did you mean 'lens'"):
            scene.pose("map", "lense")
        harness.send(transforms(2.0, ("attic", "lamp", 1.0)), topic="tf_static")
        with pytest.raises(Disconnected):
            scene.pose("map", "lamp")


def test_listener_follows_a_change_of_parent_and_refuses_cycles(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with ModuleHarness(Listening) as harness, caplog.at_level(logging.WARNING):
        scene = harness.module.scene
        harness.send(
            transforms(1.0, ("table", "cup", 1.0), ("map", "table", 2.0), ("map", "hand", 5.0)), topic="tf"
        )
        harness.send(transforms(2.0, ("hand", "cup", 0.5)), topic="tf")
        assert scene.graph.node("cup").parent == "hand"
        harness.send(transforms(2.0, ("cup", "map", 1.0), ("cup", "cup", 1.0)), topic="tf")
        said = [record.getMessage() for record in caplog.records]
        assert "'cup'" in said[0] and "hung on 'table', now on 'hand'" in said[0]
        assert "nodes hang on one another" in said[1] and "cup on cup" in said[2]
        harness.send(transforms(2.0, ("map", "hand", 6.0)), topic="tf")
        assert scene.pose("map", "cup", 2 * SECOND).x == 6.5


def test_ros_1_frames_with_a_slash_move_the_same_nodes(file: Path) -> None:
    with ModuleHarness(SceneGraphService, {"file": file}) as service:
        base = Odometry(header=Header(frame_id="/odom"), child_frame_id="/base_link")
        service.send(base, topic="odom")
        placed = TransformStamped(header=Header(frame_id="/map"), child_frame_id="/odom")
        service.send(TFMessage(transforms=[placed]), topic="placed")
        assert service.module.warnings.ignored == 0
    with ModuleHarness(Listening, {}) as listening:
        for child in ("odom", "/odom"):
            listening.send(
                TFMessage(
                    transforms=[TransformStamped(header=Header(frame_id="/map"), child_frame_id=child)]
                ),
                topic="tf",
            )
        assert [node.name for node in listening.module.scene.graph] == ["map", "odom"]
