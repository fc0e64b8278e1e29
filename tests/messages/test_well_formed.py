"""Ill-formed messages of the stock types, and what is well formed although it looks odd."""

import logging
import math

import numpy as np
import pytest

from robbie_mp.messages import (
    BatteryState,
    CameraInfo,
    Costmap,
    CostmapMetaData,
    DriveCommand,
    Duration,
    FieldError,
    Header,
    IllFormed,
    Image,
    JointCommand,
    JointState,
    LaserScan,
    MapMetaData,
    MappingState,
    Message,
    NavSatFix,
    NavSatStatus,
    OccupancyGrid,
    Odometry,
    PanTiltCommand,
    Path,
    Point,
    PointCloud2,
    PointField,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Twist,
    TwistStamped,
    Vector3,
    check_well_formed,
    find_flaw,
    stock_registry,
)
from robbie_mp.messages.refusals import MAX_KINDS, Refusals
from robbie_mp.messages.stock.registry import class_with_rules
from robbie_mp.module.harness import ModuleHarness
from robbie_mp.module.module import Module

NAN, INF = math.nan, math.inf
SECOND = Duration(sec=1)


def at(x: float) -> Pose:
    return Pose(position=Point(x=x))


def turned(yaw: float) -> Pose:
    return Pose(orientation=Quaternion.from_yaw(yaw))


def grid(cells: int, **info: object) -> OccupancyGrid:
    sizes = {"width": 3, "height": 2, "resolution": 0.05} | info
    return OccupancyGrid(info=MapMetaData(**sizes), data=np.zeros(cells, np.int8))  # type: ignore[arg-type]


def cloud(offset: int, **sizes: int) -> PointCloud2:
    field = PointField(name="x", offset=offset, datatype=PointField.FLOAT32, count=1)
    given = {"width": 2, "height": 1, "point_step": 8, "row_step": 16} | sizes
    return PointCloud2(fields=[field], data=np.zeros(16, np.uint8), **given)  # type: ignore[arg-type]


def picture(encoding: str = "rgb8", step: int = 6, size: int = 12) -> Image:
    return Image(width=2, height=2, encoding=encoding, step=step, data=np.zeros(size, np.uint8))


ILL_FORMED = [
    (MappingState(spread_m=-0.1), "spread_m"),
    (Header(stamp=Time(nanosec=1_000_000_000)), "stamp.nanosec"),
    (PoseStamped(pose=at(NAN)), "pose.position.x"),
    (PoseStamped(pose=at(1e12)), "pose.position.x"),
    (PoseStamped(pose=Pose(orientation=Quaternion(w=NAN))), "pose.orientation.x, y, z, w"),
    (PoseStamped(pose=Pose(orientation=Quaternion(w=3.0))), "pose.orientation.x, y, z, w"),
    (PoseStamped(pose=Pose(orientation=Quaternion(w=1e300))), "pose.orientation.x, y, z, w"),
    (Odometry(pose=PoseWithCovariance(pose=at(1e12))), "pose.pose.position.x"),
    (Path(poses=[PoseStamped(), PoseStamped(pose=at(-INF))]), "poses[].pose.position.x"),
    (TFMessage(transforms=[TransformStamped(transform=Transform(rotation=Quaternion(w=0.0)))]),
     "transforms[].transform.rotation"),
    (TFMessage(transforms=[TransformStamped(transform=Transform(translation=Vector3(y=1e8)))]),
     "transforms[].transform.translation.y"),
    (TwistStamped(twist=Twist(linear=Vector3(x=1e5))), "twist.linear"),
    (TwistStamped(twist=Twist(angular=Vector3(z=NAN))), "twist.angular.z"),
    (grid(5), "data"),
    (grid(6, width=0), "data"),
    (grid(6, resolution=0.0), "info.resolution"),
    (grid(6, resolution=NAN), "info.resolution"),
    (grid(6, origin=Pose(orientation=Quaternion(x=1.0, w=0.0))), "info.origin.orientation"),
    (grid(90_000, width=90_000, height=1, origin=turned(0.8)), "info.origin.orientation"),
    (grid(6, origin=at(NAN)), "info.origin.position.x"),
    (Costmap(metadata=CostmapMetaData(size_x=2, size_y=1, resolution=0.1)), "data"),
    (Costmap(metadata=CostmapMetaData(size_x=2, size_y=1), data=np.zeros(2, np.uint8)),
     "metadata.resolution"),
    (picture(size=11), "data"),
    (picture(step=5), "step"),
    (picture("mono16", size=0), "data"),
    (CameraInfo(k=np.full(9, NAN)), "k[]"),
    (CameraInfo(k=np.array([1.0, 0, 0, 0, -1.0, 0, 0, 0, 1])), "k"),
    (LaserScan(angle_min=NAN), "angle_min"),
    (LaserScan(angle_increment=INF), "angle_increment"),
    (LaserScan(angle_min=-1.0, angle_max=1.0, ranges=np.ones(3, np.float32)), "angle_increment"),
    (LaserScan(angle_increment=1.0, ranges=np.ones(99, np.float32)), "angle_increment"),
    (LaserScan(range_min=2.0, range_max=1.0), "range_max"),
    (LaserScan(range_min=-1.0), "range_min"),
    (LaserScan(ranges=np.ones(3, np.float32), intensities=np.ones(2, np.float32)), "intensities"),
    (cloud(0, row_step=15), "row_step"),
    (cloud(0, height=2), "data"),
    (cloud(6), "fields[].offset"),
    (cloud(0, point_step=0), "point_step"),
    (JointState(name=["a", "b"], position=np.zeros(1)), "position"),
    (JointState(name=["a"], position=np.array([NAN])), "position[]"),
    (BatteryState(percentage=55.0), "percentage"),
    (BatteryState(voltage=INF), "voltage"),
    (NavSatFix(status=NavSatStatus(status=NavSatStatus.STATUS_FIX), latitude=NAN), "latitude"),
    (DriveCommand(linear_m_per_s=NAN), "linear_m_per_s"),
    (DriveCommand(angular_rad_per_s=-INF), "angular_rad_per_s"),
    (DriveCommand(valid_for=Duration(sec=3600)), "valid_for"),
    (DriveCommand(valid_for=Duration(sec=-1)), "valid_for"),
    (JointCommand(name=["a"], position=np.array([INF])), "position[]"),
    (JointCommand(name=["a"], valid_for=SECOND), "position"),
    (JointCommand(valid_for=Duration(sec=1, nanosec=1)), "valid_for"),
    (PanTiltCommand(tilt_rad=NAN), "tilt_rad"),
]  # fmt: skip


@pytest.mark.parametrize(("message", "field"), ILL_FORMED, ids=lambda one: f"{type(one).__name__}-{one}"[:50])
def test_ill_formed_message_is_refused_with_its_field(message: Message, field: str) -> None:
    with pytest.raises(IllFormed, match="expected") as caught:
        check_well_formed(message)
    assert caught.value.field == field
    assert str(caught.value).startswith(message.type_name)


@pytest.mark.parametrize(
    "message",
    [
        PoseStamped(pose=Pose(orientation=Quaternion(w=0.0))),
        grid(0, width=0, height=0, resolution=0.0),
        grid(6, origin=turned(0.8)),
        grid(90_000, width=90_000, height=1, origin=turned(math.pi / 2)),
        grid(6, origin=Pose(orientation=Quaternion.from_yaw(0.5))),
        Image(),
        picture("h264", step=0, size=7),
        CameraInfo(),
        LaserScan(angle_increment=-0.1, range_max=INF, ranges=np.array([NAN, INF, -INF], np.float32)),
        PointCloud2(),
        JointState(name=["a"], effort=np.array([NAN])),
        BatteryState(voltage=NAN, percentage=NAN),
        NavSatFix(latitude=NAN, longitude=NAN, altitude=NAN),
        DriveCommand(linear_m_per_s=-0.5, valid_for=SECOND),
    ],
    ids=lambda one: type(one).__name__,
)
def test_odd_message_is_well_formed(message: Message) -> None:
    check_well_formed(message)


@pytest.mark.parametrize("message_type", list(stock_registry()), ids=lambda one: one.__name__)
def test_default_message_is_well_formed(message_type: type[Message]) -> None:
    assert find_flaw(message_type()) is None


# -- where they are refused ----------------------------------------------------------------------------------


class Listener(Module):
    """Counts what it gets, and publishes what it is told to."""

    def setup(self) -> None:
        self.got: list[Message] = []
        self.subscribe(PoseStamped, self.got.append, topic="goal")


def test_handler_gets_no_ill_formed_message(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING), ModuleHarness(Listener) as harness:
        for _ in range(5):
            harness.send(PoseStamped(pose=at(NAN)), topic="goal")
        harness.send(PoseStamped(pose=at(1.0)), topic="goal")
    assert harness.module.got == [PoseStamped(pose=at(1.0))]
    refusals = harness.bus.subscriptions.refusals
    assert refusals.by_kind == {(PoseStamped.type_name, "pose.position.x"): 5}
    assert refusals.summary == "5 ill-formed refused (PoseStamped pose.position.x 5)"
    assert len(caplog.records) == 3  # the 1st, 2nd and 4th
    assert "topic 'goal'" in caplog.text


@pytest.mark.parametrize("message", [one for one, _ in ILL_FORMED if one.is_checked], ids=repr)
def test_ill_formed_motion_cannot_be_published(message: Message) -> None:
    with ModuleHarness(Listener) as harness:
        with pytest.raises(FieldError, match="expected"):
            harness.module.publish(message)
        harness.module.publish(type(message)())
        assert len(harness.published) == 1


def test_number_of_kinds_is_bounded() -> None:
    refusals = Refusals(logging.getLogger("test"))
    for number in range(2 * MAX_KINDS):
        refusals.count(IllFormed("wrong", "some_msgs/msg/Type", f"field{number}"))
    assert refusals.total == sum(refusals.by_kind.values()) == 2 * MAX_KINDS
    assert len(refusals.by_kind) == MAX_KINDS + 1


def test_encoded_message_is_refused_if_it_is_ill_formed_or_none() -> None:
    refusals = Refusals(logging.getLogger("test"))
    known = class_with_rules(PoseStamped.type_name, PoseStamped.version)
    assert known is PoseStamped
    assert refusals.admits_encoded(known, PoseStamped().encode())
    assert refusals.admits_encoded(class_with_rules("some_msgs/msg/Type", 1), b"anything")
    assert not refusals.admits_encoded(known, PoseStamped(pose=at(INF)).encode())
    assert not refusals.admits_encoded(known, PoseStamped().encode()[:9])
    assert refusals.total == 2
