"""Converts the records of a CARMEN log to messages: odometry, scans, and the position of the laser."""

from pathlib import Path

from robbie_mp.base.balance import Balance
from robbie_mp.logs.recording.carmen import LASER_OFFSET, CarmenLog, LaserRecord, OdometryRecord, Record
from robbie_mp.logs.recording.conversion import Conversion, NewChannel, converted_log
from robbie_mp.logs.recording.errors import LogUnreadable
from robbie_mp.logs.recording.format import ChannelKey, TopicNames
from robbie_mp.logs.recording.repair import Progress
from robbie_mp.messages import (
    Header,
    LaserScan,
    Message,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
    schema_text,
)

ODOMETRY_TOPIC = "odom"
PLACE_TOPIC = "tf_static"
NO_RETURN_M = 81.0  # CARMEN's value for "no return"


def import_carmen(
    source: Path, target: Path, balance: Balance, *, skip_broken: bool, progress: Progress
) -> None:
    """Write a log from a CARMEN log, on the topics of `robbie_robots.modules.devices.carmen_playback`.

    Messages are published when their lines were recorded: the first one at its sensor's time, the others
    later by the interval that the recorder noted. The stamps in the messages are the sensors' own.

    Args:
        source: the CARMEN log.
        target: the new file.
        balance: counts messages, and lines that are left out.
        skip_broken: skip lines that cannot be read, rather than raise.
        progress: counts bytes.

    Raises:
        BrokenLine: a line cannot be read.
        LogUnreadable: the source cannot be read.
        LogNotWritten: the target exists, or cannot be written.
        LeftOut: the balance allows no loss.
    """
    carmen_log = CarmenLog(source, skip_broken=skip_broken)
    try:
        size = source.stat().st_size
        source.open("rb").close()
    except OSError as error:
        raise LogUnreadable(f"{source} cannot be read: {error.strerror}") from error
    with converted_log(target, source, balance) as conversion:
        topics = TopicNames()
        start_ns: int | None = None
        for record in carmen_log:
            if start_ns is None:
                start_ns = _nanoseconds(record.ipc_time_s) - _nanoseconds(record.logger_time_s)
                time_ns = start_ns + _nanoseconds(record.logger_time_s)
                _add(conversion, topics, laser_place(carmen_log.parameters), PLACE_TOPIC, time_ns)
            time_ns = start_ns + _nanoseconds(record.logger_time_s)
            _add(conversion, topics, *_message(record), time_ns)
            progress(carmen_log.bytes_read, size)
        balance.leave_out("broken lines", carmen_log.broken_lines)


def _message(record: Record) -> tuple[Message, str]:
    if isinstance(record, OdometryRecord):
        return odometry_message(record), ODOMETRY_TOPIC
    return scan_message(record), ""


def _add(conversion: Conversion, topics: TopicNames, message: Message, topic: str, time_ns: int) -> None:
    kind = type(message)
    key = ChannelKey(kind.type_name, kind.version, topic, "")
    channel = NewChannel(topics.of(key), kind.type_name, schema_text(kind))
    conversion.add(channel, key.metadata(), time_ns, message.encode())


def odometry_message(record: OdometryRecord) -> Odometry:
    """Convert an ODOM line to a message; its stamp is the sensor's own."""
    return Odometry(
        header=Header(stamp=stamp(record.ipc_time_s), frame_id="odom"),
        child_frame_id="base_link",
        pose=PoseWithCovariance(
            pose=Pose(
                position=Point(x=record.x_m, y=record.y_m), orientation=Quaternion.from_yaw(record.theta_rad)
            )
        ),
        twist=TwistWithCovariance(
            twist=Twist(linear=Vector3(x=record.linear_m_s), angular=Vector3(z=record.angular_rad_s))
        ),
    )


def scan_message(record: LaserRecord) -> LaserScan:
    """Convert a FLASER line to a message; its stamp is the sensor's own."""
    last = len(record.ranges_m) - 1
    return LaserScan(
        header=Header(stamp=stamp(record.ipc_time_s), frame_id="laser"),
        angle_min=record.angle_min_rad,
        angle_max=record.angle_min_rad + last * record.angle_increment_rad,
        angle_increment=record.angle_increment_rad,
        range_max=NO_RETURN_M,
        ranges=record.ranges_m,
    )


def laser_place(parameters: dict[str, str]) -> TFMessage:
    """Return the pose of the laser on the robot, from the log's parameters."""
    offset_m = float(parameters.get(LASER_OFFSET, "0"))
    place = Transform(translation=Vector3(x=offset_m), rotation=Quaternion.from_yaw(0.0))
    header = Header(frame_id="base_link")
    return TFMessage(transforms=[TransformStamped(header=header, child_frame_id="laser", transform=place)])


def stamp(seconds: float) -> Time:
    """Convert seconds since the epoch to a stamp."""
    return Time.from_nanoseconds(_nanoseconds(seconds))


def _nanoseconds(seconds: float) -> int:
    return round(seconds * 1e6) * 1000
