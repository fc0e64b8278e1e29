"""Converts the records of a CARMEN log to messages."""

from robbie_mp.messages import (
    Header,
    LaserScan,
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
)
from robbie_mp.recording.carmen import LASER_OFFSET, LaserRecord, OdometryRecord

NO_RETURN_M = 81.0  # CARMEN's value for "no return"


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
    return Time.from_nanoseconds(round(seconds * 1e6) * 1000)
