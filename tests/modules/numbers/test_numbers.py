"""The modules of the numbered signs: what they tell one another, and what they keep over a restart."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import Header, ModuleHarness, SettingError, Time
from robbie_mp.messages import (
    CameraInfo,
    Image,
    LaserScan,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_robots.modules.numbers import signs as signs_module
from robbie_robots.modules.numbers.messages import NumberSigns, SignsReached
from robbie_robots.modules.numbers.mission import Numbers
from robbie_robots.modules.numbers.referee import Referee
from robbie_robots.modules.numbers.signs import NumberSignFinder
from robbie_robots.workers.numbers.board_reader import BoardSighting
from robbie_robots.workers.numbers.digit_reader import ReaderMissing
from robbie_robots.workers.numbers.quadrangles import Quadrangle
from tests._support.places import ARENAS

SMALL = ARENAS / "numbers_small.yaml"


def truth(x_m: float, y_m: float, heading_rad: float) -> Odometry:
    """The true pose, from the start, which is at (3.5, 3.5)."""
    place = Pose(position=Point(x=x_m - 3.5, y=y_m - 3.5), orientation=Quaternion.from_yaw(heading_rad))
    return Odometry(pose=PoseWithCovariance(pose=place))


def test_referee_judges_each_visit_where_the_robot_truly_is() -> None:
    with ModuleHarness(Referee, {"arena": str(SMALL)}) as referee:
        referee.send(truth(5.9, 5.1, 0.8), topic="ground_truth")
        referee.send(SignsReached(digits=np.array([4], np.uint8)))
        referee.advance(1.0)
        referee.send(truth(3.0, 3.0, 0.0), topic="ground_truth")
        referee.send(SignsReached(digits=np.array([4, 1], np.uint8)))
        referee.advance(1.0)
        assert [visit.counts for visit in referee.module.visits] == [True, False]
        assert referee.module.visits[0].distance_m == pytest.approx(math.hypot(0.7, 0.7))
        kept = referee.checkpoint
    with ModuleHarness(Referee, {"arena": str(SMALL)}, restored=kept) as referee:
        # The newest message is latched: the restarted referee gets it again.
        referee.send(truth(3.0, 3.0, 0.0), topic="ground_truth")
        referee.send(SignsReached(digits=np.array([4, 1], np.uint8)))
        referee.advance(1.0)
        assert [visit.digit for visit in referee.module.visits] == [4, 1]


def test_missing_reader_is_named_before_anything_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ReaderMissing("digits are read with rapidocr before 3.8: install it (extra 'digits')")

    monkeypatch.setattr(signs_module, "BoardReader", missing)
    with pytest.raises(SettingError, match="extra 'digits'"):
        NumberSignFinder.check({})


class Watcher:
    """A camera on a pan joint, at (0, 0); a post stands at (2.5, 0), and each image shows a board."""

    def __init__(self, harness: ModuleHarness[NumberSignFinder]) -> None:
        self.harness = harness
        self.harness.send(CameraInfo(k=np.array([554.0, 0, 320, 0, 554, 200, 0, 0, 1])), topic="camera")
        self.tell(0.0)

    def tell(self, pan_rad: float) -> None:
        """Tell where the camera looks."""
        optical, places = Quaternion(x=-0.5, y=0.5, z=-0.5, w=0.5), []
        for parent, child, turn in (
            ("map", "laser", Quaternion.from_yaw(0.0)),
            ("laser", "pan", Quaternion.from_yaw(pan_rad)),
            ("pan", "camera_optical", optical),
        ):
            transform = Transform(translation=Vector3(), rotation=turn)
            places.append(
                TransformStamped(header=self.header(parent), child_frame_id=child, transform=transform)
            )
        self.harness.send(TFMessage(transforms=places), topic="tf")

    def header(self, frame: str) -> Header:
        return Header(stamp=Time.from_nanoseconds(self.harness.clock.now_ns()), frame_id=frame)

    def watch(self, pan_rad: float) -> None:
        """Turn the camera for 0.2 s, and take an image at the end of the turn."""
        self.harness.advance(0.2)
        self.tell(pan_rad)
        ranges = np.full(360, np.inf, np.float32)
        ranges[180] = 2.5
        self.harness.send(
            LaserScan(
                header=self.header("laser"),
                angle_min=-math.pi,
                angle_increment=math.tau / 360,
                range_max=10.0,
                ranges=ranges,
            )
        )
        header, data = self.header("camera_optical"), np.zeros(3840, np.uint8)
        image = Image(header=header, height=2, width=640, step=1920, data=data)
        self.harness.send(image, topic="camera")
        self.harness.advance(0.2)


class Reader:
    """Reads a 7 in the middle of every image."""

    def read(self, _pixels: np.ndarray) -> list[BoardSighting]:
        corners = np.array([[270, 150], [370, 150], [370, 250], [270, 250]], np.float32)
        return [BoardSighting(Quadrangle(corners), "7", 0.9, 66.0)]


def test_image_from_a_turning_camera_is_not_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The direction of the camera is not known exactly then: the board might be that of another post."""
    monkeypatch.setattr(signs_module, "BoardReader", Reader)
    with ModuleHarness(NumberSignFinder, output_directory=tmp_path) as finder:
        watcher = Watcher(finder)
        for pan_rad in (0.4, -0.4, 0.0):
            watcher.watch(pan_rad)
        assert finder.module.images == 0
        assert finder.module.signs.signs == []
        for _ in range(2):
            watcher.watch(0.0)
        assert finder.module.images == 2
        [sign] = finder.module.signs.signs
        assert sign.votes == {"7": 2}
        assert sign.xy_m == pytest.approx([2.5, 0.0], abs=0.01)
        finder.module.teardown()
        [written] = json.loads((tmp_path / "signs.json").read_text())
        assert (written["text"], written["places"]) == (None, [[0.0, 0.0, {"7": 2}]])
        kept = finder.checkpoint
    with ModuleHarness(NumberSignFinder, restored=kept) as finder:
        [again] = finder.module.signs.signs
        assert (again.votes, again.places[0].xy_m) == ({"7": 2}, (0.0, 0.0))


def test_mission_takes_signs_and_writes_its_results(tmp_path: Path) -> None:
    with ModuleHarness(Numbers, output_directory=tmp_path) as mission:
        mission.send(
            NumberSigns(
                x_m=np.array([1.0, 2.0, 3.0]),
                y_m=np.zeros(3),
                facing_rad=np.full(3, np.nan),
                digits=np.array([7, NumberSigns.UNKNOWN, NumberSigns.OTHER], np.int8),
                likely=np.array([7, 3, NumberSigns.UNKNOWN], np.int8),
                views=np.array([5, 1, 0], np.uint16),
                searched=np.array([1, 2, 4095], np.uint16),
                sheet="70",
                images=5,
            )
        )
        reports = mission.module.mission.signs
        assert [(one.digit, one.is_open) for one in reports] == [(7, False), (None, True), (None, False)]
        assert [(one.likely, one.views, one.searched) for one in reports] == [
            (7, 5, 1),
            (3, 1, 2),
            (None, 0, 4095),
        ]
        mission.advance(1.0)
        assert mission.module.status.endswith("sees 7")
        mission.module.teardown()
        assert json.loads((tmp_path / "numbers.json").read_text())["reached"] == []
