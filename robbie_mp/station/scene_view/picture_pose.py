"""Where a frame was when a picture was taken."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from robbie_mp.scene import SceneGraphError, TooNew, TooOld

if TYPE_CHECKING:
    from robbie_mp.scene import RigidTransform, SceneGraphListener

MAP = "map"
TURNED_RAD = 0.03
"""A smaller turn of a camera moves what it sees by less than a thirtieth of its picture."""


def pose_for_picture(
    scene: SceneGraphListener, world: str, frame: str, time_ns: int | None = None
) -> RigidTransform | None:
    """Return the pose of a frame, X_WF, at a time or the nearest known one; None if none is known."""
    try:
        try:
            return scene.pose(world, frame, time_ns)
        except (TooNew, TooOld):
            return scene.pose(world, frame)
    except SceneGraphError:
        return None


def has_turned(scene: SceneGraphListener, frame: str, before_ns: int, now_ns: int) -> bool:
    """Return whether a frame has turned between two times by more than can be neglected in its picture."""
    before, now = (pose_for_picture(scene, MAP, frame, at_ns) for at_ns in (before_ns, now_ns))
    if before is None or now is None or before_ns == now_ns:
        return False
    turn = before.inverse() @ now
    return 2.0 * math.acos(min(1.0, abs(turn.qw))) > TURNED_RAD
