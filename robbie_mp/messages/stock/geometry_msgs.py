"""Points, poses, velocities and transforms (ROS geometry_msgs).

Frames are right-handed: on a robot x forward, y left, z up (REP 103). Lengths in m, angles in rad.
"""

import math
from typing import Literal

from typing_extensions import Self

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import MAX_MAGNITUDE, MAX_POSITION_M, Flaw, beyond
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float64
from robbie_mp.messages.stock.std_msgs import Header


class Point(Message, name="geometry_msgs/msg/Point", version=1):
    """A position in space."""

    x: float64 = DEFAULT  # m
    y: float64 = DEFAULT  # m
    z: float64 = DEFAULT  # m

    def flaw(self) -> Flaw | None:
        """Return a coordinate that is not finite, or too far away."""
        return beyond(self, MAX_POSITION_M, "x", "y", "z")


class Vector3(Message, name="geometry_msgs/msg/Vector3", version=1):
    """A direction and magnitude in space; its unit is that of the field it is used for."""

    x: float64 = DEFAULT
    y: float64 = DEFAULT
    z: float64 = DEFAULT

    def flaw(self) -> Flaw | None:
        """Return a number that is not finite."""
        return beyond(self, MAX_MAGNITUDE, "x", "y", "z")


UNIT_TOLERANCE = 0.01
"""Most by which the length of a quaternion differs from 1."""


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

    def flaw(self) -> Flaw | None:
        """Return whether it is no rotation. All zero means that it was never set, and is taken for none."""
        length_2 = self.x * self.x + self.y * self.y + self.z * self.z + self.w * self.w
        if abs(length_2 - 1.0) <= 2.0 * UNIT_TOLERANCE or length_2 == 0.0:
            return None
        value = (self.x, self.y, self.z, self.w)
        return Flaw("x, y, z, w", value, "a unit quaternion, or all 0 if it was not set")


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


MAX_SPEED_M_PER_S = 1e4
MAX_TURN_RAD_PER_S = 1e4
"""No robot moves faster."""


class Twist(Message, name="geometry_msgs/msg/Twist", version=1):
    """A velocity, linear and angular."""

    linear: Vector3 = DEFAULT  # m/s
    angular: Vector3 = DEFAULT  # rad/s, about the axes

    def flaw(self) -> Flaw | None:
        """Return whether it is faster than anything."""
        linear, angular = self.linear, self.angular
        fastest = max(abs(linear.x), abs(linear.y), abs(linear.z))
        if fastest > MAX_SPEED_M_PER_S:
            return Flaw("linear", fastest, f"at most {MAX_SPEED_M_PER_S:g} m/s")
        fastest = max(abs(angular.x), abs(angular.y), abs(angular.z))
        if fastest > MAX_TURN_RAD_PER_S:
            return Flaw("angular", fastest, f"at most {MAX_TURN_RAD_PER_S:g} rad/s")
        return None


class TwistWithCovariance(Message, name="geometry_msgs/msg/TwistWithCovariance", version=1):
    """A velocity and how uncertain it is.

    The covariance is a row-major 6 x 6 matrix of linear x, y, z (m/s) and angular x, y, z (rad/s).
    """

    twist: Twist = DEFAULT
    covariance: Array[float64, Literal[36]] = DEFAULT


class TwistStamped(Message, name="geometry_msgs/msg/TwistStamped", version=1, checked=True):
    """A velocity in a frame, at a time."""

    header: Header = DEFAULT
    twist: Twist = DEFAULT


class Transform(Message, name="geometry_msgs/msg/Transform", version=1):
    """Where one frame lies in another: rotate first, then translate."""

    translation: Vector3 = DEFAULT  # m
    rotation: Quaternion = DEFAULT

    def flaw(self) -> Flaw | None:
        """Return whether one frame is too far from the other, or has no rotation."""
        if (flaw := beyond(self.translation, MAX_POSITION_M, "x", "y", "z")) is not None:
            return flaw._replace(field=f"translation.{flaw.field}")
        turn = self.rotation
        if turn.x == turn.y == turn.z == turn.w == 0.0:
            return Flaw("rotation", (0.0, 0.0, 0.0, 0.0), "a unit quaternion")
        return None


class TransformStamped(Message, name="geometry_msgs/msg/TransformStamped", version=1):
    """Where the frame `child_frame_id` lies in the frame `header.frame_id`, at a time."""

    header: Header = DEFAULT
    child_frame_id: str = DEFAULT
    transform: Transform = DEFAULT
