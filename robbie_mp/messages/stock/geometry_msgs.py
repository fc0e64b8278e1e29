"""Points, poses, velocities and transforms (ROS geometry_msgs).

Frames are right-handed: on a robot x forward, y left, z up (REP 103). Lengths in m, angles in rad.
"""

import math
from typing import Literal, Self

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float64
from robbie_mp.messages.stock.std_msgs import Header


class Point(Message, name="geometry_msgs/msg/Point", version=1):
    """A position in space."""

    x: float64 = DEFAULT  # m
    y: float64 = DEFAULT  # m
    z: float64 = DEFAULT  # m


class Vector3(Message, name="geometry_msgs/msg/Vector3", version=1):
    """A direction and magnitude in space; its unit is that of the field it is used for."""

    x: float64 = DEFAULT
    y: float64 = DEFAULT
    z: float64 = DEFAULT


class Quaternion(Message, name="geometry_msgs/msg/Quaternion", version=1):
    """An orientation in space, as a unit quaternion; no rotation by default."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0

    @property
    def yaw(self) -> float:
        """Rotation about the z axis: rad, in [-pi, pi]; then come pitch and roll (intrinsic z-y'-x'')."""
        return math.atan2(
            2.0 * (self.w * self.z + self.x * self.y), 1.0 - 2.0 * (self.y * self.y + self.z * self.z)
        )

    @classmethod
    def from_yaw(cls, yaw: float) -> Self:
        """Return the rotation by `yaw` (rad) about the z axis, counter-clockwise seen from above."""
        return cls(z=math.sin(yaw / 2.0), w=math.cos(yaw / 2.0))


class Pose(Message, name="geometry_msgs/msg/Pose", version=1):
    """A position and an orientation."""

    position: Point = DEFAULT
    orientation: Quaternion = DEFAULT


class PoseWithCovariance(Message, name="geometry_msgs/msg/PoseWithCovariance", version=1):
    """A pose and how uncertain it is.

    The covariance is a row-major 6 x 6 matrix of x, y, z (m) and the rotations about the X, Y, Z axes (rad).
    """

    pose: Pose = DEFAULT
    covariance: Array[float64, Literal[36]] = DEFAULT


class PoseStamped(Message, name="geometry_msgs/msg/PoseStamped", version=1):
    """A pose in a frame, at a time."""

    header: Header = DEFAULT
    pose: Pose = DEFAULT


class PoseWithCovarianceStamped(Message, name="geometry_msgs/msg/PoseWithCovarianceStamped", version=1):
    """A pose in a frame, at a time, and how uncertain it is."""

    header: Header = DEFAULT
    pose: PoseWithCovariance = DEFAULT


class Twist(Message, name="geometry_msgs/msg/Twist", version=1):
    """A velocity, linear and angular."""

    linear: Vector3 = DEFAULT  # m/s
    angular: Vector3 = DEFAULT  # rad/s, about the axes


class TwistWithCovariance(Message, name="geometry_msgs/msg/TwistWithCovariance", version=1):
    """A velocity and how uncertain it is.

    The covariance is a row-major 6 x 6 matrix of linear x, y, z (m/s) and angular x, y, z (rad/s).
    """

    twist: Twist = DEFAULT
    covariance: Array[float64, Literal[36]] = DEFAULT


class TwistStamped(Message, name="geometry_msgs/msg/TwistStamped", version=1):
    """A velocity in a frame, at a time."""

    header: Header = DEFAULT
    twist: Twist = DEFAULT


class Transform(Message, name="geometry_msgs/msg/Transform", version=1):
    """Where one frame lies in another: rotate first, then translate."""

    translation: Vector3 = DEFAULT  # m
    rotation: Quaternion = DEFAULT


class TransformStamped(Message, name="geometry_msgs/msg/TransformStamped", version=1):
    """Where the frame `child_frame_id` lies in the frame `header.frame_id`, at a time."""

    header: Header = DEFAULT
    child_frame_id: str = DEFAULT
    transform: Transform = DEFAULT
