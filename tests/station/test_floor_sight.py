"""Places on the floor in pictures: the projection of cameras, and what cannot be a place on the floor."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the operator's page needs the extra gui")

from robbie_mp.messages import CameraInfo, Header, Image, MappingState, PoseStamped, RegionOfInterest, Time
from robbie_mp.scene import Joint, JointType, Node, RigidTransform, SceneGraph
from robbie_mp.station.driving.motion import Movement
from robbie_mp.station.floor.camera_model import CameraModel, NoFloor
from robbie_mp.station.floor.picture import track_of
from robbie_mp.station.floor.sight import FloorSight, Spot, Touch, checked, floor_point, reach_of
from robbie_mp.station.floor.touch_to_go import tilted
from robbie_mp.station.watch.latest import Latest

K = np.array([300.0, 0.0, 310.0, 0.0, 310.0, 230.0, 0.0, 0.0, 1.0])
LENSES = {
    "none": ("plumb_bob", []),
    "barrel": ("plumb_bob", [-0.28, 0.07, 0.001, -0.0005, 0.0]),
    "pincushion": ("plumb_bob", [0.15, 0.02, 0.0, 0.001, 0.0]),
    "rational": ("rational_polynomial", [0.9, 0.2, 0.0002, 0.0, 0.01, 1.2, 0.4, 0.03]),
}
AHEAD = RigidTransform(0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5)
EYE_M = (0.2, 0.05, 0.6)
SECOND = 1_000_000_000


def info(lens: str = "none", **changed: Any) -> CameraInfo:
    model, d = LENSES[lens]
    fields = {"width": 640, "height": 480, "k": K, "d": np.array(d, float), "distortion_model": model}
    return CameraInfo(**{**fields, **changed})


def mount(pan_rad: float = 0.0, down_rad: float = 0.35) -> RigidTransform:
    return RigidTransform.from_rpy(EYE_M, (0.0, down_rad, pan_rad)) @ AHEAD


@pytest.mark.parametrize("lens", LENSES)
def test_projection_is_that_of_opencv(lens: str) -> None:
    cv2 = pytest.importorskip("cv2")
    points = np.random.default_rng(1).uniform((-1.0, -0.8, 1.5), (1.0, 0.8, 6.0), (100, 3))
    expected = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), K.reshape(3, 3), np.array(LENSES[lens][1])
    )[0]
    assert CameraModel.of(info(lens)).project(points) == pytest.approx(expected.reshape(-1, 2), abs=1e-6)


@pytest.mark.parametrize("lens", LENSES)
def test_ray_of_a_pixel_leads_back_to_it(lens: str) -> None:
    model = CameraModel.of(info(lens))
    for column in (0.0, 150.0, 310.0, 639.0):
        for row in (0.0, 230.0, 479.0):
            found = model.project(3.0 * model.ray(column, row)[None])
            assert found[0] == pytest.approx([column, row], abs=0.5)


def test_what_is_behind_or_far_beside_a_camera_is_not_in_its_picture() -> None:
    model = CameraModel.of(info("barrel"))
    points = [(0.0, 0.0, -1.0), (0.0, 0.0, 0.0), (9.0, 0.0, 1.0), (3.0, 0.0, 1.0)]
    assert np.isnan(model.project(points)).all()  # also where the distortion folds back into the picture


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({"k": np.zeros(9)}, "not calibrated"),
        ({"width": 0}, "not calibrated"),
        ({"k": np.full(9, math.nan)}, "no projection"),
        ({"k": np.array([300.0, 0, 1, 0, -300.0, 1, 0, 0, 1])}, "no projection"),
        ({"d": np.array([math.inf] * 5)}, "no projection"),
        ({"distortion_model": "equidistant", "d": np.ones(4)}, "'equidistant', is not known"),
        ({"d": np.ones(8)}, "is not known"),
        ({"binning_x": 2}, "a part of its picture"),
        ({"roi": RegionOfInterest(width=10, height=10)}, "a part of its picture"),
    ],
)
def test_camera_without_a_known_projection_says_why(told: dict[str, Any], why: str) -> None:
    with pytest.raises(NoFloor, match=why):
        CameraModel.of(info(**told))


@pytest.mark.parametrize("d", [[1e300] * 8, [-1e3, 0, 0, 0, 0], [0, 0, 0, 0, 0, -1.0, 0, 0]])
def test_nonsense_of_a_calibration_is_refused_or_bounded(d: list[float]) -> None:
    model = CameraModel.of(info(distortion_model="rational_polynomial", d=np.array(d, float)))
    assert 0.0 <= model.reach <= 10.0
    with pytest.raises(NoFloor):
        floor_point(model, mount(), 0.02, 0.98)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("pan_rad", [0.0, 0.8, math.pi])
def test_place_that_is_seen_is_the_place_that_is_pressed(lens: str, pan_rad: float) -> None:
    model, X_BC = CameraModel.of(info(lens)), mount(pan_rad)
    for ahead_m, left_m in ((1.2, 0.0), (2.5, 0.8), (4.0, -1.5)):
        place = X_BC.translation * (1.0, 1.0, 0.0) + (
            ahead_m * math.cos(pan_rad) - left_m * math.sin(pan_rad),
            ahead_m * math.sin(pan_rad) + left_m * math.cos(pan_rad),
            0.0,
        )
        (pixel,) = model.project(X_BC.inverse().apply(place[None]))
        across, down = (pixel + 0.5) / (640, 480)
        assert floor_point(model, X_BC, across, down) == pytest.approx(place, abs=0.02)


def test_what_is_no_near_floor_is_refused() -> None:
    model = CameraModel.of(info())
    for down, why in ((0.05, "above the horizon"), (0.3, "is 8 m away: press a place nearer than 5.9 m")):
        with pytest.raises(NoFloor, match=why):
            floor_point(model, mount(), 0.5, down)
    for height_m in (0.0, -1.0, math.nan):
        with pytest.raises(NoFloor, match="not above the floor"):
            floor_point(model, mount()._replace(z=height_m), 0.5, 0.9)


def test_higher_camera_measures_farther() -> None:
    assert [round(reach_of(height_m), 1) for height_m in (0.1, 0.35, 1.1, 30.0)] == [2.4, 4.5, 7.9, 10.0]


@pytest.mark.parametrize(
    "sent",
    [
        None,
        [],
        {},
        {"camera": "eye", "stamp": "5", "across": 0.5},
        {"camera": "eye", "stamp": "5", "across": math.nan, "down": 0.5},
        {"camera": "eye", "stamp": "5", "across": 1.5, "down": 0.5},
        {"camera": "eye", "stamp": "-5", "across": 0.5, "down": 0.5},
        {"camera": "eye", "stamp": "9" * 5000, "across": 0.5, "down": 0.5},
        {"camera": "eye", "stamp": "now", "across": 0.5, "down": 0.5},
        {"camera": "eye", "stamp": None, "across": 0.5, "down": 0.5},
    ],
)
def test_malformed_presses_are_ignored(sent: Any) -> None:
    assert checked(sent) is None


def test_press_is_read() -> None:
    sent = {"camera": "eye", "stamp": "1790000000123456789", "across": 0.25, "down": 1}
    assert checked(sent) == Touch("eye", 1790000000123456789, 0.25, 1.0)


def test_track_is_that_of_the_order_or_else_of_the_motion() -> None:
    assert track_of(Movement(linear_m_per_s=0.1, commanded_linear=0.5, commanded_angular=0.2), 0.4) == [
        0.5,
        0.2,
        0.2,
    ]
    assert track_of(Movement(linear_m_per_s=-0.25, angular_rad_per_s=0.1), 0.4) == [-0.25, 0.1, 0.2]
    assert track_of(Movement(linear_m_per_s=0.25, angular_rad_per_s=0.1, silent="3 s"), 0.4) is None
    assert track_of(Movement(linear_m_per_s=0.25, commanded_linear=0.0, commanded_angular=1.0), 0.4) is None
    assert track_of(Movement(linear_m_per_s=math.nan), 0.4) is None
    assert track_of(Movement(), 0.4) is None


def test_tilted_robot_does_not_measure() -> None:
    assert tilted(None, None) == tilted(0.05, -0.05) == ""
    assert "tilted by 11°" in tilted(0.02, -0.2)


class Watched:
    """A robot that moves ahead at 1 m/s and whose camera may pan, and its station's clock."""

    def __init__(self) -> None:
        self.time_ns = 100 * SECOND
        self.latest: dict[Any, Latest[Any]] = {}
        self.on_info: Callable[[CameraInfo], None] = lambda _info: None
        self.envelope = SimpleNamespace(topic="eye")
        floating = Joint(JointType.FLOATING)
        self.graph = SceneGraph(
            [
                Node("map"),
                Node("odom", "map", joint=floating),
                Node("base_link", "odom", joint=floating),
                Node("camera", "base_link", joint=floating),
            ]
        )
        self.pages = ["page"]
        births: Any = SimpleNamespace(of=self._born_s, now_s=lambda: self.time_ns / SECOND)
        source: Any = self
        self.sight = FloorSight(source, self.graph, births, source, self.pages)
        self.latest[PoseStamped].put(PoseStamped())
        self.pose_s = 100.0

    def now_ns(self) -> int:
        return self.time_ns

    def newest(self, message_type: Any, _topic: str = "") -> Any:
        return self.latest.setdefault(message_type, Latest())

    def hear(self, _type: Any, handler: Any) -> None:
        self.on_info = handler

    def _born_s(self, latest: Latest[Any]) -> float | None:
        return self.pose_s if latest.count else None

    def moves(self, from_s: float, to_s: float, pan_rad_per_s: float = 0.0) -> None:
        """Tell where everything was between two times."""
        for at in range(round(20 * from_s), round(20 * to_s) + 1):
            at_ns = at * SECOND // 20
            self.graph.move("base_link", at_ns, RigidTransform.from_rpy((at / 20 - 100.0, 0.0, 0.0)))
            self.graph.move("camera", at_ns, mount(pan_rad_per_s * (at / 20 - 100.0)))
        self.time_ns = at_ns

    def corrects(self, x_m: float, yaw_rad: float = 0.0) -> None:
        """Place the frame of odometry on the map, as mapping does."""
        self.graph.move("odom", self.time_ns, RigidTransform.from_rpy((x_m, 0.0, 0.0), (0.0, 0.0, yaw_rad)))

    def takes(self, at_s: float) -> Image:
        header = Header(stamp=Time.from_nanoseconds(round(at_s * SECOND)), frame_id="camera")
        image = Image(header=header, width=640, height=480)
        self.sight.see("eye", image)
        return image

    def finds(self, at_s: float, camera: str = "eye") -> Spot:
        self.sight.tick()
        future = self.sight.locate(Touch(camera, round(at_s * SECOND), 0.5, 0.5))
        self.sight.tick()
        return future.result(0.0)


@pytest.fixture
def robot() -> Watched:
    made = Watched()
    made.moves(99.0, 100.0)
    made.corrects(0.0)
    made.on_info(info())
    made.takes(100.0)
    return made


AHEAD_M = 0.2 + 0.6 / math.tan(0.35 + math.atan((0.5 * 480 - 0.5 - 230.0) / 310.0))
"""How far ahead of the robot the middle of its picture shows the floor."""
RIGHT_M = 0.05 - 1.614 * 9.5 / 300.0
"""And how far to the left: the principal point is 9.5 pixels beside the middle."""


def test_place_is_where_the_camera_was_when_it_took_the_picture(robot: Watched) -> None:
    robot.moves(100.0, 101.0)
    robot.pose_s = 101.0
    for taken_s in (99.5, 100.0, 100.73):
        spot = robot.finds(taken_s)
        assert (spot.x_m, spot.y_m) == pytest.approx((taken_s - 100.0 + AHEAD_M, RIGHT_M), abs=0.005)
        assert spot.eye == pytest.approx((taken_s - 100.0 + 0.2, 0.05), abs=1e-6)


def test_place_is_on_the_map_as_it_was_corrected_since(robot: Watched) -> None:
    before = robot.finds(100.0)
    robot.moves(100.0, 100.5)
    robot.corrects(2.0)
    robot.sight.tick()
    assert robot.sight.place_of(before) == pytest.approx((before.x_m + 2.0, before.y_m), abs=1e-6)
    assert robot.finds(100.0).x_m == pytest.approx(before.x_m + 2.0, abs=1e-6)


def test_stale_pictures_and_poses_are_refused(robot: Watched) -> None:
    robot.moves(100.0, 103.0)
    robot.pose_s = 103.0
    for taken_s, why in ((100.0, "is 3.0 s old"), (103.5, "is -0.5 s old")):
        with pytest.raises(NoFloor, match=why):
            robot.finds(taken_s)
    robot.pose_s = 100.0
    with pytest.raises(NoFloor, match="position on the map is 3 s old"):
        robot.finds(103.0)
    robot.pose_s = 103.0
    robot.latest[MappingState].put(MappingState(certain=False))
    with pytest.raises(NoFloor, match="does not know where it is"):
        robot.finds(103.0)
    assert robot.sight.place_of(Spot(0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0), 1.0)) is None


def test_picture_whose_camera_has_no_known_pose_is_refused(robot: Watched) -> None:
    robot.time_ns += SECOND  # and nobody tells where the robot is meanwhile
    robot.pose_s = 101.0
    with pytest.raises(NoFloor, match="where the camera was when it took that picture is not known"):
        robot.finds(101.0)
    with pytest.raises(NoFloor, match="does not tell how it is calibrated"):
        robot.finds(101.0, camera="nose")


def test_turning_camera_is_not_measured_by(robot: Watched) -> None:
    robot.moves(100.05, 101.0, pan_rad_per_s=1.0)
    robot.pose_s = 101.0
    with pytest.raises(NoFloor, match="the camera was turning"):
        robot.finds(100.5)


def test_nothing_is_known_after_a_jump_of_time(robot: Watched) -> None:
    spot = robot.finds(100.0)
    robot.graph.forget()
    robot.sight.forget()
    assert robot.sight.place_of(spot) is None
    with pytest.raises(NoFloor):
        robot.finds(100.0)


def test_page_that_has_not_waited_harms_nothing(robot: Watched) -> None:
    robot.sight.tick()
    future = robot.sight.locate(Touch("eye", robot.time_ns, 0.5, 0.5))
    assert future.cancel()
    robot.sight.tick()
    assert robot.finds(100.0)


def test_questions_that_wait_are_bounded(robot: Watched) -> None:
    futures = [robot.sight.locate(Touch("eye", robot.time_ns, 0.5, 0.5)) for _ in range(40)]
    with pytest.raises(NoFloor, match="busy"):
        futures[-1].result(0.0)


def test_pages_get_the_view_of_each_picture_or_why_there_is_none(robot: Watched) -> None:
    robot.sight.tick()
    told = robot.sight.about("eye", robot.takes(100.0))
    assert told["stamp"] == "100000000000"
    view: Any = told["floor"]
    in_camera = np.array(view["base"]).reshape(3, 3) @ (AHEAD_M, 0.05, 1.0)
    column, row = in_camera[:2] / in_camera[2] * view["focal"] + view["centre"]
    assert (column, row) == pytest.approx((310.5 / 640, 0.5), abs=1e-3)
    older = Image(header=Header(stamp=Time.from_nanoseconds(99 * SECOND)))
    assert robot.sight.about("eye", older) == {"stamp": "99000000000"}  # the view is of a newer one
    assert robot.sight.about("eye", robot.takes(100.5))["no_floor"] == (
        "where the camera was at that moment is not known"
    )
    robot.moves(100.0, 100.5)
    robot.sight.tick()  # and then it becomes known
    assert robot.sight.about("eye", robot.takes(100.5))["floor"]
    robot.on_info(info(width=320))
    assert "another size" in str(robot.sight.about("eye", robot.takes(100.5))["no_floor"])


def test_camera_that_is_not_looked_at_costs_nothing(robot: Watched) -> None:
    robot.pages.clear()
    image = robot.takes(100.2)
    assert robot.sight.about("eye", image) == {"stamp": str(image.header.stamp.nanoseconds)}
