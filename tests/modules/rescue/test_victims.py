"""The module of victims: images and transforms in, victims and searched walls out; the operator decides."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from robbie_mp import CallRefused, Header, ModuleHarness, SettingError, Time
from robbie_mp.messages import (
    CameraInfo,
    Detection2DArray,
    Image,
    MapMetaData,
    Mark,
    OccupancyGrid,
    Point,
    Pose,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose as Pose2D
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import ArenaVictim, VictimKind, WallSpot
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.camera import SimulatedCamera
from robbie_robots.modules.devices.camera import intrinsic_matrix
from robbie_robots.modules.rescue.messages import AnswerVictim, SearchedWalls, VictimFound
from robbie_robots.modules.rescue.victims import Victims
from robbie_robots.workers.rescue import victim_detection

GEOMETRY = CameraGeometry(400, 200, 1.4)
EYE_Z_M = GEOMETRY.mount_m[2]
ROOM_M, TAG = 4.0, 9
ARENA = Arena(
    segments=box_segments(np.array([[0.0, 0.0, ROOM_M, ROOM_M]])),
    circles=np.zeros((0, 3)),
    start=Pose2D(1.0, 1.0, 0.0),
    width_m=ROOM_M,
    height_m=ROOM_M,
    victims=(ArenaVictim(TAG, VictimKind.STILL, WallSpot(ROOM_M, 2.0, 0.35, math.pi)),),
)
OPTICAL = Quaternion(x=-0.5, y=0.5, z=-0.5, w=0.5)


class Watching:
    """The messages of the module's robot. All frames are those of the arena."""

    def __init__(self, harness: ModuleHarness[Victims]) -> None:
        self.harness = harness
        self.camera = SimulatedCamera(ARENA, GEOMETRY)
        cells = np.zeros((90, 90), np.int8)  # from -0.25 m on; the walls are at 0 and 4 m
        cells[4, 4:86] = cells[85, 4:86] = cells[4:86, 4] = cells[4:86, 85] = 100
        info = MapMetaData(
            resolution=0.05, width=90, height=90, origin=Pose(position=Point(x=-0.25, y=-0.25))
        )
        harness.send(OccupancyGrid(info=info, data=cells.ravel()))
        harness.send(
            CameraInfo(height=GEOMETRY.height, width=GEOMETRY.width, k=intrinsic_matrix(GEOMETRY).ravel()),
            topic="camera",
        )
        self.tell_places("tf_static", ("camera", "camera_optical", (0.0, 0.0, 0.0), OPTICAL))

    def tell_places(self, topic: str, *places: tuple[Any, ...]) -> None:
        now = Time.from_nanoseconds(self.harness.clock.now_ns())
        transforms = [
            TransformStamped(
                header=Header(stamp=now, frame_id=parent),
                child_frame_id=child,
                transform=Transform(translation=Vector3(x=x, y=y, z=z), rotation=turn),
            )
            for parent, child, (x, y, z), turn in places
        ]
        self.harness.send(TFMessage(transforms=transforms), topic=topic)

    def look(self, x_m: float, y_m: float, pan_rad: float = 0.0, images: int = 5) -> None:
        """Take images from a place, the robot looking along x, the camera turned on it."""
        for _ in range(images):
            self.harness.advance(0.2)
            base, pan = Quaternion.from_yaw(0.0), Quaternion.from_yaw(pan_rad)
            self.tell_places(
                "tf",
                ("map", "base_link", (x_m, y_m, 0.0), base),
                ("base_link", "camera", (0.0, 0.0, EYE_Z_M), pan),
            )
            self.camera.place(Pose2D(x_m - GEOMETRY.mount_m[0], y_m, 0.0), 0.0)
            self.camera.look(pan_rad, 0.0)
            self.send_image()
        self.harness.advance(0.2)

    def send_image(self) -> None:
        pixels = self.camera.capture().pixels
        stamp = Time.from_nanoseconds(self.harness.clock.now_ns())
        image = Image(
            header=Header(stamp=stamp, frame_id="camera_optical"),
            height=GEOMETRY.height,
            width=GEOMETRY.width,
            encoding="rgb8",
            step=3 * GEOMETRY.width,
            data=pixels.ravel(),
        )
        self.harness.send(image, topic="camera")

    def last(self) -> VictimFound:
        return self.harness.take(VictimFound)[-1]


@pytest.fixture
def watching() -> Iterator[Watching]:
    with ModuleHarness(Victims) as harness:
        yield Watching(harness)


def test_missing_opencv_is_an_error_before_anything_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(victim_detection, "import_module", missing)
    with pytest.raises(SettingError, match="opencv-python-headless"):
        Victims.check({})


def test_victim_is_placed_on_the_map_and_the_operator_is_asked(watching: Watching) -> None:
    watching.look(2.8, 1.7)
    found = watching.last()
    assert (found.id, found.state) == (TAG, VictimFound.ASKED)
    assert found.answer_within_s == pytest.approx(watching.harness.module.answer_s, abs=1.0)
    place = found.pose.position
    assert (place.x, place.y, place.z) == pytest.approx((ROOM_M, 2.0, 0.35), abs=0.1)
    assert abs(found.pose.orientation.yaw) == pytest.approx(math.pi, abs=0.3)
    assert found.image.data.size == 3 * found.image.width * found.image.height > 0


def test_moment_in_which_a_victim_is_known_well_is_marked_once(watching: Watching) -> None:
    watching.look(2.8, 1.7)
    watching.look(2.8, 1.6)
    (mark,) = watching.harness.take(Mark)
    assert mark.text.startswith(f"victim found: tag {TAG} at 4.0, 2.0")


def test_places_of_tags_are_published_with_the_images_header(watching: Watching) -> None:
    watching.look(2.8, 2.0)
    found = watching.harness.take(Detection2DArray, "camera")[-1]
    (tag,) = found.detections
    assert (found.header.frame_id, tag.id) == ("camera_optical", str(TAG))
    # 1.2 m away, straight ahead: 0.25 m wide, and as high as the camera.
    focal_px = 200 / math.tan(0.7)
    assert tag.bbox.size_x == pytest.approx(0.25 * focal_px / 1.2, rel=0.05)
    assert tag.bbox.center.position.x == pytest.approx(200, abs=2)
    assert tag.results[0].hypothesis.class_id == f"tag {TAG}"
    watching.look(2.8, 2.0, pan_rad=2.0)
    assert watching.harness.take(Detection2DArray, "camera")[-1].detections == []


@pytest.mark.parametrize(
    ("answer", "state"),
    [
        (AnswerVictim.YES, VictimFound.CONFIRMED),
        (AnswerVictim.NO, VictimFound.REJECTED),
        (AnswerVictim.LATER, VictimFound.SUSPECTED),
    ],
)
def test_operators_answer_decides(watching: Watching, answer: int, state: int) -> None:
    watching.look(2.8, 2.0)
    assert watching.harness.call(AnswerVictim(id=TAG, answer=answer)).state == state
    assert watching.last().state == state
    watching.look(2.8, 2.0)  # more views change nothing
    assert watching.last().state == state


def test_unanswered_question_is_repeated_up_to_its_limit(watching: Watching) -> None:
    watching.look(2.8, 2.0)
    states = []
    for _ in range(30):
        watching.harness.advance(10.0)
        states += [found.state for found in watching.harness.take(VictimFound)]
    asked = [state for before, state in zip([0, *states], states, strict=False) if state != before]
    assert asked == [VictimFound.ASKED, VictimFound.SUSPECTED] * 2
    assert states[-1] == VictimFound.SUSPECTED


def test_unknown_answers_and_answers_about_unknown_victims_are_refused(watching: Watching) -> None:
    watching.look(2.8, 2.0)
    with pytest.raises(CallRefused, match="there is no victim 33"):
        watching.harness.call(AnswerVictim(id=33, answer=AnswerVictim.YES))
    with pytest.raises(CallRefused, match="there is no answer 9"):
        watching.harness.call(AnswerVictim(id=TAG, answer=9))
    assert watching.last().state == VictimFound.ASKED


def test_victim_seen_only_from_a_distance_stays_suspected(watching: Watching) -> None:
    watching.look(1.9, 2.0)
    assert watching.last().state == VictimFound.SUSPECTED


def test_victims_are_confirmed_without_an_operator_if_set_so() -> None:
    with ModuleHarness(Victims, {"confirms_by_itself": True}) as harness:
        watching = Watching(harness)
        watching.look(2.8, 2.0)
        assert watching.last().state == VictimFound.CONFIRMED


def test_image_is_used_only_when_the_cameras_pose_is_known(watching: Watching) -> None:
    watching.look(2.8, 2.0, images=2)  # of the first it is not known whether the camera turned
    watching.harness.advance(1.0)
    watching.send_image()  # no transform is as new as this
    watching.harness.advance(1.0)
    assert watching.harness.module.images == 1


def test_image_taken_while_the_camera_turns_is_not_used(watching: Watching) -> None:
    watching.look(2.8, 2.0, pan_rad=0.3, images=1)
    watching.look(2.8, 2.0, pan_rad=0.0, images=1)
    used = watching.harness.module.images
    watching.look(2.8, 2.0, pan_rad=0.0, images=1)
    assert (used, watching.harness.module.images) == (0, 1)


def test_walls_in_view_count_as_searched(watching: Watching) -> None:
    watching.look(2.8, 2.0)
    watching.harness.advance(2.0)
    grid = watching.harness.take(SearchedWalls)[-1]
    cells = grid.data.reshape(90, 90)
    assert cells[45, 84] == 100  # the wall ahead
    assert cells[45, 5] == 0  # the wall behind
    assert cells[45, 45] == -1  # no wall


def test_restarted_module_knows_victims_answers_and_searched_walls(watching: Watching) -> None:
    watching.look(2.8, 2.0)
    watching.harness.call(AnswerVictim(id=TAG, answer=AnswerVictim.NO))
    with ModuleHarness(Victims, restored=watching.harness.checkpoint) as again:
        restarted = Watching(again)
        again.advance(2.0)
        assert restarted.last().state == VictimFound.REJECTED
        assert (again.take(SearchedWalls)[-1].data == 100).any()
