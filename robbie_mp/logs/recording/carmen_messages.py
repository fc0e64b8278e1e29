"""Converts the records of a CARMEN log to messages: what it measured, and the places of its lasers."""

import math
from collections import Counter
from functools import singledispatch
from typing import NamedTuple

from robbie_mp.logs.recording.carmen_records import (
    FRONT,
    REAR,
    FixRecord,
    ImuRecord,
    LaserRecord,
    OdometryRecord,
    Pose2,
    PoseRecord,
    RawLaserRecord,
    Record,
)
from robbie_mp.messages import (
    Header,
    Imu,
    LaserScan,
    Message,
    NavSatFix,
    NavSatStatus,
    Odometry,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
)

PLACE_TOPIC = "tf_static"
NAMES = {FRONT: "front", REAR: "rear"}
FRAMES = {FRONT: "laser", REAR: "laser_rear"}
TOPICS = {FRONT: "", REAR: "laser/rear"}
OLD_KINDS = {FRONT: "FLASER", REAR: "RLASER"}
DEFAULT_PLACES = {FRONT: (0.0, 0.0, 0.0), REAR: (0.0, 0.0, math.pi)}
OFFSETS = ("offset", "side_offset", "angular_offset")
"""Parameters of a laser's place: m to the front and to the left, rad."""
FARTHEST_M = 2.0
"""Between poses farther apart is no robot's laser: the first poses are corrected ones of the robot."""
SAME_M, SAME_RAD = 0.005, 0.01
"""Lines round poses; less is no movement of the laser."""


class Survey(NamedTuple):
    """What a log contains; the reader needs it before the first record.

    Attributes:
        kinds: number of lines by their first words, without comments; "" for all that name no record.
        first: the first line of each laser, by CARMEN's number.
        parameters: the last value of each.
    """

    kinds: Counter[str]
    first: dict[int, LaserRecord]
    parameters: dict[str, str]


class LaserPlaces:
    """Where the lasers are on the robot.

    Lines of the newer dialect state it. For the older one, parameters do; without these, the poses in the
    lines, if they can be those of a laser and its robot.
    """

    def __init__(self, survey: Survey):
        self._places: dict[int, Pose2] = {}
        for laser in (FRONT, REAR):
            has_lines = {OLD_KINDS[laser], f"ROBOTLASER{laser}", f"RAWLASER{laser}"} & survey.kinds.keys()
            if has_lines or laser == FRONT:
                self._places[laser] = _first_place(laser, survey)
        for laser, record in survey.first.items():
            self._places.setdefault(laser, record.laser_pose)

    def change(self, record: Record) -> bool:
        """Take the place from a line that states it, and return whether it is another one than before."""
        if not isinstance(record, LaserRecord) or not record.states_place:
            return False
        known = self._places.get(record.laser)
        if known is not None and _is_same(known, record.laser_pose):
            return False
        self._places[record.laser] = record.laser_pose
        return True

    def message(self) -> TFMessage:
        """Return the places of all lasers."""
        return TFMessage(transforms=[_transform(laser, place) for laser, place in self._places.items()])


def is_offset(parameter: str) -> bool:
    """Whether a parameter is a part of a laser's place, and so a number."""
    return any(parameter == f"robot_{name}laser_{offset}" for name in NAMES.values() for offset in OFFSETS)


def topic_of(record: Record, kinds: Counter[str]) -> str:
    """Return the topic of a record's message.

    Sweeps without the robot's pose have a topic of their own where the same ones are in the log with it.
    """
    match record:
        case OdometryRecord():
            return "odom"
        case PoseRecord():
            return "truepos" if record.is_true else "globalpos"
        case ImuRecord():
            return "imu"
        case FixRecord():
            return "gnss" if record.receiver <= 1 else f"gnss/{record.receiver}"
    laser = record.laser
    has_twin = f"ROBOTLASER{laser}" in kinds or OLD_KINDS.get(laser) in kinds
    if has_twin and not isinstance(record, LaserRecord):
        return f"laser/raw_{laser}"
    return TOPICS.get(laser, f"laser/{laser}")


@singledispatch
def message_of(record: Record) -> Message:
    """Convert a record to a message; its stamp is the sensor's own."""
    raise NotImplementedError(record)


@message_of.register
def _(record: OdometryRecord) -> Odometry:
    place = Point(x=record.x_m, y=record.y_m)
    pose = Pose(position=place, orientation=Quaternion.from_yaw(record.theta_rad))
    twist = Twist(linear=Vector3(x=record.linear_m_s), angular=Vector3(z=record.angular_rad_s))
    return Odometry(
        header=_header(record, "odom"),
        child_frame_id="base_link",
        pose=PoseWithCovariance(pose=pose),
        twist=TwistWithCovariance(twist=twist),
    )


@message_of.register
def _(record: RawLaserRecord) -> LaserScan:
    last = len(record.ranges_m) - 1
    return LaserScan(
        header=_header(record, _frame(record.laser)),
        angle_min=record.angle_min_rad,
        angle_max=record.angle_min_rad + last * record.angle_increment_rad,
        angle_increment=record.angle_increment_rad,
        range_max=record.range_max_m,
        ranges=record.ranges_m,
        intensities=record.remissions,
    )


@message_of.register
def _(record: PoseRecord) -> PoseStamped:
    x_m, y_m, yaw_rad = record.pose
    pose = Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(yaw_rad))
    return PoseStamped(header=_header(record, "map"), pose=pose)


@message_of.register
def _(record: ImuRecord) -> Imu:
    w, x, y, z = record.orientation
    return Imu(
        header=_header(record, "imu"),
        orientation=Quaternion(x=x, y=y, z=z, w=w),
        angular_velocity=_vector(record.turn_rates),
        linear_acceleration=_vector(record.acceleration),
    )


@message_of.register
def _(record: FixRecord) -> NavSatFix:
    known = {0: NavSatStatus.STATUS_NO_FIX, 2: NavSatStatus.STATUS_SBAS_FIX}
    corrected = dict.fromkeys((4, 5), NavSatStatus.STATUS_GBAS_FIX)
    status = (known | corrected).get(record.quality, NavSatStatus.STATUS_FIX)
    return NavSatFix(
        header=_header(record, "gnss"),
        status=NavSatStatus(status=status, service=NavSatStatus.SERVICE_GPS),
        latitude=record.latitude_deg,
        longitude=record.longitude_deg,
        altitude=record.height_m,
    )


def nanoseconds(seconds: float) -> int:
    """Convert a time; logs have microseconds."""
    return round(seconds * 1e6) * 1000


def _vector(values: tuple[float, float, float]) -> Vector3:
    x, y, z = values
    return Vector3(x=x, y=y, z=z)


def _header(record: Record, frame: str) -> Header:
    return Header(stamp=Time.from_nanoseconds(nanoseconds(record.ipc_time_s)), frame_id=frame)


def _frame(laser: int) -> str:
    return FRAMES.get(laser, f"laser_{laser}")


def _first_place(laser: int, survey: Survey) -> Pose2:
    names = [f"robot_{NAMES[laser]}laser_{offset}" for offset in OFFSETS]
    default, record = DEFAULT_PLACES[laser], survey.first.get(laser)
    if record is not None and record.states_place:
        return record.laser_pose
    if names[0] in survey.parameters:
        values = zip(names, default, strict=True)
        x_m, y_m, yaw_rad = (float(survey.parameters.get(name, value)) for name, value in values)
        return x_m, y_m, yaw_rad
    is_place = record is not None and math.hypot(*record.laser_pose[:2]) <= FARTHEST_M
    return record.laser_pose if record is not None and is_place else default


def _is_same(one: Pose2, other: Pose2) -> bool:
    turn = math.remainder(one[2] - other[2], math.tau)
    return math.dist(one[:2], other[:2]) < SAME_M and abs(turn) < SAME_RAD


def _transform(laser: int, place: Pose2) -> TransformStamped:
    x_m, y_m, yaw_rad = place
    transform = Transform(translation=Vector3(x=x_m, y=y_m), rotation=Quaternion.from_yaw(yaw_rad))
    header = Header(frame_id="base_link")
    return TransformStamped(header=header, child_frame_id=_frame(laser), transform=transform)
