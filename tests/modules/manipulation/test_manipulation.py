"""The modules that see and grasp: what they serve, refuse, publish, and keep over a restart."""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
from typing_extensions import Self

from robbie_mp import Header, ModuleHarness, SettingError, Time
from robbie_mp.messages import (
    BoundingBox2D,
    CallRefusal,
    CameraInfo,
    ControlState,
    Detection2DArray,
    GoalEnd,
    Image,
    JointCommand,
    JointState,
    Odometry,
    Point,
    Point2D,
    PointsOfInterest,
    Pose,
    Pose2D,
    PoseStamped,
    PoseWithCovariance,
    TaughtNames,
    TeachRecognition,
    TFMessage,
)
from robbie_mp.module.harness import NotSubscribed
from robbie_mp.scene.module import SceneGraphService
from robbie_robots.modules.manipulation.manipulation import Manipulation
from robbie_robots.modules.manipulation.messages import (
    HandOver,
    HandStatus,
    PickUp,
    PickUpFeedback,
    PutDown,
    TableObjects,
    TabletopTruth,
)
from robbie_robots.modules.manipulation.simulated_arm import SimulatedArm
from robbie_robots.modules.manipulation.simulated_depth_camera import SimulatedDepthCameraModule
from robbie_robots.modules.manipulation.table_objects import TableObjectFinder, read_objects
from robbie_robots.modules.taught_recognition import TaughtObjects
from tests._support.places import ARENAS, PROJECT

pytest.importorskip("pinocchio", reason="arms need the extra 'arm'")

ROBOT = str(PROJECT / "hw/robots/home.urdf")
OBJECTS = PROJECT / "hw/robots/home_objects.yaml"
NAMES = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll", "gripper"]
STOWED = [0.0, -0.8, -0.3, 0.0, 1.1, 0.0, 0.045]


# -- manipulation ----------------------------------------------------------------------------------------


@pytest.fixture
def hand() -> Iterator[ModuleHarness[Manipulation]]:
    with ModuleHarness(Manipulation, {"robot": ROBOT}) as harness:
        yield harness


def hear_joints(hand: ModuleHarness[Manipulation], seconds: float, positions: list[float] = STOWED) -> None:
    """Let the module work, and hear that the joints are always at the same positions."""
    for _ in range(round(seconds / 0.1)):
        stamp = Time.from_nanoseconds(hand.clock.now_ns())
        hand.send(
            JointState(header=Header(stamp=stamp), name=NAMES, position=np.array(positions)), topic="arm"
        )
        hand.advance(0.1)


def test_orders_that_make_no_sense_are_refused(hand: ModuleHarness[Manipulation]) -> None:
    hand.send_goal(PickUp())
    hand.send_goal(PutDown(object="soup"))
    reasons = [refusal.reason for refusal in hand.take(CallRefusal)]
    assert reasons == ["which object? Its name is empty", "there is nothing in the hand"]


def test_arm_is_commanded_only_with_an_order_and_where_it_is_known(hand: ModuleHarness[Manipulation]) -> None:
    hear_joints(hand, 1.0)
    assert not hand.take(JointCommand)
    hand.send_goal(PickUp(object="soup"))
    hear_joints(hand, 1.0)
    commands = hand.take(JointCommand, "arm")
    assert commands[0].name == NAMES
    assert commands[0].valid_for.nanoseconds == 300_000_000
    assert commands[0].position.tolist() == pytest.approx(STOWED)
    assert [told.state for told in hand.take(PickUpFeedback)][:2] == ["RECOVER", "FREE"]
    hand.advance(1.0)  # the joints are silent
    hand.take(JointCommand, "arm")
    hand.advance(0.5)
    assert not hand.take(JointCommand, "arm")


def test_arm_stays_where_it_is_while_the_robot_holds_and_then_goes_on(
    hand: ModuleHarness[Manipulation],
) -> None:
    hand.send_goal(PickUp(object="soup"))
    hear_joints(hand, 1.0)
    last = hand.take(JointCommand, "arm")[-1]
    hand.send(ControlState(mode=ControlState.HOLD), topic="control")
    hear_joints(hand, 5.0)
    held = hand.take(JointCommand, "arm")
    assert all((command.position == last.position).all() for command in held)
    assert len(held) >= 50  # its joints are not let go
    hand.send(ControlState(mode=ControlState.AUTO), topic="control")
    hear_joints(hand, 0.2)
    assert hand.take(JointCommand, "arm")[0].position.tolist() == pytest.approx(STOWED, abs=0.1)
    assert hand.module.work.task == "pick up"


def test_arm_restarted_while_the_robot_holds_stays_where_it_is(hand: ModuleHarness[Manipulation]) -> None:
    hand.send_goal(PickUp(object="soup"))
    hear_joints(hand, 1.0)
    hand.send(ControlState(mode=ControlState.HOLD), topic="control")
    with ModuleHarness(Manipulation, {"robot": ROBOT}, restored=hand.checkpoint) as again:
        hear_joints(again, 3.0)  # the base has failed: nobody tells the state again
        moved = [one.position for one in again.take(JointCommand, "arm")]
        assert all(position == pytest.approx(STOWED, abs=1e-6) for position in moved)


def test_newer_order_takes_the_place_of_another_one_and_a_cancelled_one_ends(
    hand: ModuleHarness[Manipulation],
) -> None:
    hand.send_goal(PickUp(object="soup"), client="first")
    hear_joints(hand, 0.5)
    sent = hand.send_goal(PickUp(object="tea"), client="second")
    (end,) = hand.take(GoalEnd, "first")
    assert (end.outcome, end.reason) == (GoalEnd.PREEMPTED, "second has sent another goal")
    hand.cancel_goal(sent, "enough", client="second")
    (end,) = hand.take(GoalEnd, "second")
    assert (end.outcome, end.reason) == (GoalEnd.CANCELLED, "enough")
    hear_joints(hand, 0.2)
    hand.take(JointCommand)
    hear_joints(hand, 0.5)
    assert not hand.take(JointCommand)


def test_order_survives_a_restart_and_is_told_to_its_client(hand: ModuleHarness[Manipulation]) -> None:
    hand.send_goal(PickUp(object="soup"), client="mission")
    hear_joints(hand, 0.5)
    with ModuleHarness(Manipulation, {"robot": ROBOT}, restored=hand.checkpoint) as again:
        assert (again.module.work.task, again.module.work.target) == ("pick up", "soup")
        hear_joints(again, 1.0)
        assert again.take(JointCommand, "arm")
        assert again.take(PickUpFeedback, "mission")[-1].state == "FREE"
        # The same order of its client's next process goes on; it does not begin again.
        again.send_goal(PickUp(object="soup"), client="next")
        assert again.module.work.machine.state.name == "FREE"


def test_hand_tells_what_it_holds_and_hands_nothing_over_if_it_is_empty(
    hand: ModuleHarness[Manipulation],
) -> None:
    hear_joints(hand, 0.2)
    assert [(told.state, told.held) for told in hand.take(HandStatus)] == [("REST", "")]
    hand.send_goal(HandOver(object="soup"))
    assert hand.take(CallRefusal)[0].reason == "there is nothing in the hand"


def test_missing_library_leaves_the_arm_out_if_the_profile_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    # Not a SettingError: the check of profiles leaves optional modules out that cannot import something.
    with pytest.raises(ImportError, match="extra 'arm'"):
        Manipulation.check(
            {"robot": Path(ROBOT), "joints": NAMES[:6], "fingers": ["gripper", "right_finger"]}
        )


def test_mistakes_in_the_robot_are_named_before_anything_starts() -> None:
    for settings, problem in (
        ({"joints": ["wasit"]}, "no joint 'wasit'"),
        ({"joints": []}, "needs joints and fingers"),
    ):
        with (
            pytest.raises(SettingError, match=problem),
            ModuleHarness(Manipulation, {"robot": ROBOT, **settings}),
        ):
            pass


# -- what the camera sees --------------------------------------------------------------------------------


class TableRobot:
    """The modules that see, of a robot that stands 0.3 m before the table with its arm aside.

    Args:
        arena: the room.
        finder: settings of the module that finds objects.
    """

    place = Pose(position=Point(x=0.65, y=0.05))
    aside = (1.9, 0.3, 0.9, 0.0, -1.2, 0.0, 0.0)

    def __init__(self, arena: Path, **finder: object) -> None:
        self._stack = ExitStack()
        arm_settings = {"arena": str(arena), "robot": ROBOT, "names": NAMES, "rest": [*self.aside]}
        camera_settings = {"arena": str(arena), "robot": ROBOT, "picture_width": 960}
        scene_settings = {"file": str(PROJECT / "hw/robots/home.yaml")}
        enter = self._stack.enter_context
        self.arm = enter(ModuleHarness(SimulatedArm, arm_settings, name="arm"))
        self.camera = enter(ModuleHarness(SimulatedDepthCameraModule, camera_settings))
        self.finder = enter(ModuleHarness(TableObjectFinder, {"objects": str(OBJECTS), **finder}))
        with ModuleHarness(SceneGraphService, scene_settings) as scene:
            self._tell_scene(scene)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: object) -> None:
        self._stack.close()

    def _tell_scene(self, scene: ModuleHarness[SceneGraphService]) -> None:
        stamp = Header(stamp=Time.from_nanoseconds(1_000), frame_id="odom")
        there = PoseWithCovariance(pose=self.place)
        scene.send(Odometry(header=stamp, child_frame_id="base_link", pose=there), topic="odom")
        scene.send(
            PoseStamped(header=Header(stamp=stamp.stamp, frame_id="map"), pose=self.place), topic="map_pose"
        )
        scene.advance(1.0)
        for topic in ("tf_static", "tf"):
            for message in scene.take(TFMessage, topic):
                self.finder.send(message, topic=topic)

    def look(self, stamp_s: float = 0.0) -> tuple[Image, Image]:
        """Take a depth image and a picture, and let the finder see the depth image."""
        stamp = Time.from_nanoseconds(round(stamp_s * 1e9))
        truth = Odometry(header=Header(stamp=stamp), pose=PoseWithCovariance(pose=self.place))
        self.arm.send(truth, topic="ground_truth")
        self.camera.send(truth, topic="ground_truth")
        self.arm.advance(0.1)
        self.camera.send(self.arm.take(TabletopTruth)[-1], topic="ground_truth")
        self.camera.send(self.arm.take(JointState)[-1], topic="arm")
        self.camera.advance(1.1)
        for topic in ("depth", "table_camera"):
            with suppress(NotSubscribed):  # that of the pictures only if objects are named in them
                self.finder.send(self.camera.take(CameraInfo, topic)[-1], topic=topic)
        depth = self.camera.take(Image, "depth")[-1]
        self.finder.send(depth, topic="depth")
        return depth, self.camera.take(Image, "table_camera")[-1]


def test_depth_images_become_a_table_with_named_objects_on_the_map() -> None:
    with TableRobot(ARENAS / "arm.yaml") as robot:
        robot.look()
        (seen,) = robot.finder.take(TableObjects)
        (shown,) = robot.finder.take(PointsOfInterest, "objects")
    assert seen.table.size.z == pytest.approx(0.4, abs=0.005)
    # The arena's (3.82, 1.80) lies (1.07, 0.05) from the robot's start, so 0.42 m ahead.
    by_name = {one.name: one.pose.position for one in seen.objects}
    assert set(by_name) == {"soup", "tea", "cola"}
    assert (by_name["soup"].x, by_name["soup"].y) == pytest.approx((0.42, 0.0), abs=0.01)
    on_map = {point.name: point.pose.position for point in shown.points}
    assert (on_map["soup"].x, on_map["soup"].y) == pytest.approx((1.07, 0.05), abs=0.01)


def room_of_twins(file: Path, left: int, right: int) -> Path:
    """Write a room with two boxes of the same size; these are the seeds of their prints."""
    text = (ARENAS / "arm.yaml").read_text().partition("objects:")[0] + "objects:\n"
    for name, y_m, print_seed in (("one", 1.90, left), ("other", 1.70, right)):
        place = f"x_m: 3.82, y_m: {y_m}, yaw_rad: 1.2, print: {print_seed}"
        text += f"  - {{name: {name}, box: [0.06, 0.04, 0.12], {place}}}\n"
    file.write_text(text)
    return file


def beside(robot: TableRobot) -> dict[str, int]:
    """Where the objects are that were found: 1 to the left, -1 to the right."""
    (seen,) = robot.finder.take(TableObjects)
    return {one.name: 1 if one.pose.position.y > 0 else -1 for one in seen.objects}


def test_boxes_of_one_size_that_were_taught_from_pictures_are_told_apart(tmp_path: Path) -> None:
    pytest.importorskip("cv2", reason="recognition of objects needs the extra 'vision'")
    settings = {"camera": "table_camera"}
    with ModuleHarness(TaughtObjects, settings, name="objects") as recognizer:
        before = room_of_twins(tmp_path / "before.yaml", left=11, right=12)
        with TableRobot(before, pictures="table_camera") as robot:
            _, picture = robot.look()
            by_size = beside(robot)
            assert len(by_size) == 2 and "tea" in by_size and "Mint" not in by_size
            for name, column in (("tea", 358.0), ("Mint", 602.0)):
                centre = Pose2D(position=Point2D(x=column, y=408.0))
                box = BoundingBox2D(center=centre, size_x=100.0, size_y=170.0)
                recognizer.call(TeachRecognition(name=name, image=picture, box=box), topic="objects")
        names = recognizer.latched(TaughtNames, "objects")
        assert names is not None
        after = room_of_twins(tmp_path / "after.yaml", left=12, right=11)
        with TableRobot(after, pictures="table_camera") as robot:
            robot.finder.send(names, topic="objects", sender="objects")
            _, picture = robot.look()
            assert robot.finder.take(TableObjects) == []  # what the picture shows is not known yet
            recognizer.send(picture, topic="table_camera")
            recognizer.advance(0.2)
            found = recognizer.take(Detection2DArray, "table_camera")[-1]
            robot.finder.send(found, topic="table_camera", sender="somebody else")
            assert robot.finder.take(TableObjects) == []
            robot.finder.send(found, topic="table_camera", sender="objects")
            assert beside(robot) == {"Mint": 1, "tea": -1}
            assert robot.finder.checkpoint == {"Mint": ["tea"], "tea": ["tea"]}


def test_depth_image_whose_picture_is_not_searched_is_used_after_a_while() -> None:
    with TableRobot(ARENAS / "arm.yaml", pictures="table_camera") as robot:
        robot.finder.send(TaughtNames(names=["mint"]), topic="objects", sender="objects")
        for stamp_s in (1.0, 2.0, 3.0):
            robot.look(stamp_s)
            assert robot.finder.take(TableObjects) == []
        robot.look(4.0)
        (seen,) = robot.finder.take(TableObjects)
        assert seen.header.stamp == Time(sec=1)
        assert {one.name for one in seen.objects} == {"soup", "tea", "cola"}
        # What is found in a picture belongs to the depth image of the same time.
        late = Detection2DArray(header=Header(stamp=Time(sec=3), frame_id="depth_optical"))
        robot.finder.send(late, topic="table_camera", sender="objects")
        assert robot.finder.take(TableObjects)[-1].header.stamp == Time(sec=3)
        assert (robot.finder.module.alone, robot.finder.module.skipped) == (1, 1)
        # If all is forgotten, nothing waits.
        robot.finder.send(TaughtNames(), topic="objects", sender="objects")
        robot.look(5.0)
        assert [seen.header.stamp for seen in robot.finder.take(TableObjects)] == [Time(sec=5)]


@pytest.mark.parametrize(
    "text",
    [
        *("", "[1]", "soup: {can: [0.1]}", "soup: {ball: [0.1]}", "soup: {box: [1, 2, -3]}", "soup: ["),
        *(
            "soup: {can: [66, 100]}",
            "soup: {can: [.inf, .1]}",
            "soup: 2026-13-45",
            "soup: {can: 3}",
            "[" * 500,
        ),
        *("soup: {can: [.1, .1]}\nsoup: {can: [.2, .2]}", "soup: {can: [true, 0.1]}"),
    ],
)
def test_invalid_file_of_objects_is_an_error_of_the_setting(tmp_path: Path, text: str) -> None:
    file = tmp_path / "objects.yaml"
    file.write_text(text)
    with pytest.raises(SettingError, match=r"objects\.yaml"):
        TableObjectFinder.check({"objects": file})


def test_stock_objects_are_those_of_the_random_rooms() -> None:
    sizes = {known.name: (known.size_m, known.is_round) for known in read_objects(OBJECTS)}
    assert sizes == {
        "soup": ((0.066, 0.066, 0.1), True),
        "tea": ((0.06, 0.04, 0.12), False),
        "cola": ((0.052, 0.052, 0.14), True),
    }
