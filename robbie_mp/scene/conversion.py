"""Poses of the scene graph as messages, and back."""

from robbie_mp.messages import Point, Pose, Quaternion, Transform, Vector3
from robbie_mp.scene.rigid_transform import RigidTransform


def from_pose(pose: Pose) -> RigidTransform:
    """Return the pose of a message.

    Raises:
        NotAPose: a number is not finite, or the quaternion's length is not 1.
    """
    return _rigid(pose.position, pose.orientation)


def from_transform(transform: Transform) -> RigidTransform:
    """Return the pose of a message.

    Raises:
        NotAPose: a number is not finite, or the quaternion's length is not 1.
    """
    return _rigid(transform.translation, transform.rotation)


def to_pose(pose: RigidTransform) -> Pose:
    """Return the message of a pose."""
    x, y, z, qx, qy, qz, qw = pose
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def to_transform(pose: RigidTransform) -> Transform:
    """Return the message of a pose."""
    x, y, z, qx, qy, qz, qw = pose
    return Transform(translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _rigid(place: Point | Vector3, turn: Quaternion) -> RigidTransform:
    return RigidTransform.of((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
