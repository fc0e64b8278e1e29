"""Poses of a log as trajectories in the text formats of TUM and KITTI, which evaluation tools read.

Source: TUM RGB-D benchmark, file formats (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats):
`timestamp tx ty tz qx qy qz qw`; KITTI odometry benchmark, development kit: the first three rows of the pose
matrix, one after the other.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from robbie_mp.logs.recording.errors import LogError
from robbie_mp.messages import Message

POSE_OF = {
    "nav_msgs/msg/Odometry": "pose.pose",
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "geometry_msgs/msg/TransformStamped": "transform",
}
"""Where a type has its pose."""
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TRAJECTORY_TYPES = (*POSE_OF, TRANSFORMS)
TUM_HEADING = "# timestamp tx ty tz qx qy qz qw\n"


class NoPose(LogError, ValueError):
    """A message has no pose that can be written.

    Example scenarios:
      - a quaternion of zeros, as in a message that nobody has filled
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
        x, y, z, w = self.turn
        rows = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        matrix = np.column_stack([rows, self.position])
        return " ".join(f"{number:.9g}" for number in matrix.ravel()) + "\n"


def poses(message: Message, published_ns: int) -> Iterator[StampedPose]:
    """Yield the poses of a message.

    Args:
        message: one of `TRAJECTORY_TYPES`.
        published_ns: stands for a stamp that is 0.

    Raises:
        NoPose: a pose is not one.
    """
    if message.type_name != TRANSFORMS:
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
    stamp = message.header.stamp
    time_ns = stamp.sec * 10**9 + stamp.nanosec or published_ns
    return StampedPose(frames, time_ns, _position(place), _unit(turn))


def _position(place: Any) -> tuple[float, float, float]:
    if not all(map(math.isfinite, position := (place.x, place.y, place.z))):
        raise NoPose("a position that is not finite")
    return position


def _unit(turn: Any) -> tuple[float, float, float, float]:
    length = math.hypot(turn.x, turn.y, turn.z, turn.w)
    if not 0.5 < length < 2:  # also not a number
        raise NoPose("a rotation that is no quaternion of length 1")
    return turn.x / length, turn.y / length, turn.z / length, turn.w / length
