"""Poses of a log as trajectories in the text formats of TUM and KITTI, which evaluation tools read.

Source: TUM RGB-D benchmark, file formats (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats):
`timestamp tx ty tz qx qy qz qw`; KITTI odometry benchmark, development kit: the first three rows of the pose
matrix, one after the other.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from robbie_mp.logs.recording.errors import LogError
from robbie_mp.messages import Message, TFMessage
from robbie_mp.scene.rigid_transform import RigidTransform

POSE_OF = {
    "nav_msgs/msg/Odometry": "pose.pose",
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "geometry_msgs/msg/TransformStamped": "transform",
}
"""Where a type has its pose."""
TRAJECTORY_TYPES = (*POSE_OF, TFMessage.type_name)
TUM_HEADING = "# timestamp tx ty tz qx qy qz qw\n"


class NoPose(LogError, ValueError):
    """A message has no pose that can be written.

    Example scenarios:
      - a quaternion of zeros, as in a message with default values
      - a position that is not a number
    """


class StampedPose(NamedTuple):
    """A pose at a time."""

    frames: str
    """`parent-child`, for a transform; '' for the one pose of a message."""
    time_ns: int
    position: tuple[float, float, float]
    """m."""
    turn: tuple[float, float, float, float]
    """Unit quaternion x, y, z, w."""

    def tum(self) -> str:
        """Return the line of TUM's format."""
        seconds, nanoseconds = divmod(self.time_ns, 10**9)
        numbers = " ".join(f"{number:.9g}" for number in (*self.position, *self.turn))
        return f"{seconds}.{nanoseconds:09} {numbers}\n"

    def kitti(self) -> str:
        """Return the line of KITTI's format, which has no time."""
        matrix = RigidTransform(*self.position, *self.turn).matrix
        return " ".join(f"{number:.9g}" for number in matrix[:3].ravel()) + "\n"


def poses(message: Message, published_ns: int) -> Iterator[StampedPose]:
    """Yield the poses of a message.

    Args:
        message: one of `TRAJECTORY_TYPES`.
        published_ns: stands for a stamp that is 0.

    Raises:
        NoPose: a pose is not one.
    """
    if message.type_name != TFMessage.type_name:
        yield _pose(message, POSE_OF[message.type_name], published_ns, "")
        return
    for one in message.transforms:  # type: ignore[attr-defined]
        frames = f"{one.header.frame_id}-{one.child_frame_id}"
        yield _pose(one, POSE_OF["geometry_msgs/msg/TransformStamped"], published_ns, frames)


def _pose(message: Any, path: str, published_ns: int, frames: str) -> StampedPose:
    pose = message
    for name in path.split("."):
        pose = getattr(pose, name)
    place, turn = (
        (pose.translation, pose.rotation) if path == "transform" else (pose.position, pose.orientation)
    )
    return StampedPose(frames, stamp_ns(message, published_ns), _position(place), _unit(turn))


def stamp_ns(message: Any, published_ns: int) -> int:
    """Return the stamp in a message's header; if that is 0, the time at which it was published."""
    stamp = message.header.stamp  # of a type that may be made from a schema, so without our class's methods
    return stamp.sec * 10**9 + stamp.nanosec or published_ns


def _position(place: Any) -> tuple[float, float, float]:
    if not all(map(math.isfinite, position := (place.x, place.y, place.z))):
        raise NoPose("a position that is not finite")
    return position


def _unit(turn: Any) -> tuple[float, float, float, float]:
    length = math.hypot(turn.x, turn.y, turn.z, turn.w)
    if not 0.5 < length < 2:  # also not a number
        raise NoPose("a rotation that is no quaternion of length 1")
    return turn.x / length, turn.y / length, turn.z / length, turn.w / length
