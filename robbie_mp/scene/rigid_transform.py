"""Poses in space: a translation and a unit quaternion.

X_AB is the pose of frame B in frame A, and p_A = X_AB p_B, as in Drake's notation
(https://drake.mit.edu/doxygen_cxx/group__multibody__notation.html), so that X_AC = X_AB X_BC. Quaternions are
in the order x, y, z, w, as in ROS geometry_msgs.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.scene.errors import NotAPose

UNIT_TOLERANCE = 1e-3
"""Tolerance of a quaternion's length, so that four written digits suffice; it is then normalized."""

Pose7 = tuple[float, float, float, float, float, float, float]


class RigidTransform(NamedTuple):
    """A pose X_AB: translation in m, and a unit quaternion."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    qx: float = 0.0
    qy: float = 0.0
    qz: float = 0.0
    qw: float = 1.0

    @classmethod
    def of(
        cls,
        translation: Sequence[float] = (0.0, 0.0, 0.0),
        quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
    ) -> "RigidTransform":
        """Return the pose with a translation (3,), m, and a quaternion (4,): x, y, z, w.

        Raises:
            NotAPose: a number is not finite, or the quaternion's length is not 1 (within 0.001).
        """
        x, y, z = map(float, translation)
        return cls(x, y, z, *unit(quaternion)) if _all_finite(x, y, z) else _refuse((x, y, z))

    @classmethod
    def from_rpy(
        cls, translation: Sequence[float] = (0.0, 0.0, 0.0), rpy: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> "RigidTransform":
        """Return a pose that rotates about the parent's x, then y, then z axis: roll, pitch, yaw in rad.

        Raises:
            NotAPose: a number is not finite.
        """
        if not _all_finite(*rpy):
            raise NotAPose(f"roll, pitch and yaw must be finite, not {tuple(rpy)}")
        (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle / 2), math.cos(angle / 2)) for angle in rpy)
        quaternion = (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )
        return cls.of(translation, quaternion)

    @property
    def translation(self) -> NDArray[np.float64]:
        """(3,) m."""
        return np.array(self[:3])

    @property
    def quaternion(self) -> NDArray[np.float64]:
        """(4,) x, y, z, w."""
        return np.array(self[3:])

    @property
    def yaw(self) -> float:
        """Rotation about the z axis: rad, in [-pi, pi]; then come pitch and roll (intrinsic z-y'-x'')."""
        _, _, _, x, y, z, w = self
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) homogeneous matrix, which maps points of B to A."""
        px, py, pz, x, y, z, w = self
        return np.array(
            (
                (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), px),
                (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), py),
                (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), pz),
                (0.0, 0.0, 0.0, 1.0),
            )
        )

    def __matmul__(self, other: "RigidTransform") -> "RigidTransform":
        """Return X_AC = X_AB @ X_BC."""
        return RigidTransform(*compose(self, other))

    def inverse(self) -> "RigidTransform":
        """Return X_BA."""
        return RigidTransform(*relative(self, IDENTITY))

    def apply(self, points: ArrayLike) -> NDArray[np.float64]:
        """Transform points (N, 3) or (3,), m, from frame B to frame A."""
        matrix = self.matrix
        return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


IDENTITY = RigidTransform()


def compose(first: Pose7, second: Pose7) -> Pose7:
    """Return X_AC of X_AB and X_BC."""
    px, py, pz, ax, ay, az, aw = first
    x, y, z, bx, by, bz, bw = second
    # The vector (x, y, z) turned by the quaternion a: v + 2 w (a x v) + 2 a x (a x v).
    tx, ty, tz = 2.0 * (ay * z - az * y), 2.0 * (az * x - ax * z), 2.0 * (ax * y - ay * x)
    return (
        px + x + aw * tx + ay * tz - az * ty,
        py + y + aw * ty + az * tx - ax * tz,
        pz + z + aw * tz + ax * ty - ay * tx,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def relative(first: Pose7, second: Pose7) -> Pose7:
    """Return X_BC of X_AB and X_AC."""
    px, py, pz, ax, ay, az, aw = first
    x, y, z, bx, by, bz, bw = second
    x, y, z = x - px, y - py, z - pz
    # As in `compose`, with the inverse of the first quaternion.
    tx, ty, tz = 2.0 * (az * y - ay * z), 2.0 * (ax * z - az * x), 2.0 * (ay * x - ax * y)
    return (
        x + aw * tx - ay * tz + az * ty,
        y + aw * ty - az * tx + ax * tz,
        z + aw * tz - ax * ty + ay * tx,
        aw * bx - ax * bw - ay * bz + az * by,
        aw * by + ax * bz - ay * bw - az * bx,
        aw * bz - ax * by + ay * bx - az * bw,
        aw * bw + ax * bx + ay * by + az * bz,
    )


def interpolate(first: Pose7, second: Pose7, share: float) -> Pose7:
    """Return the pose `share` (0 to 1) of the way from one to the other.

    The translation is interpolated linearly; the rotation at constant angular velocity, the shorter way round
    (slerp: Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985).
    """
    if first == second:  # usual for corrections
        return first
    px, py, pz, ax, ay, az, aw = first
    x, y, z, bx, by, bz, bw = second
    if ax * bx + ay * by + az * bz + aw * bw < 0.0:
        bx, by, bz, bw = -bx, -by, -bz, -bw
    # The angle between them by Kahan's formula, which is exact for small ones too.
    apart = math.hypot(ax - bx, ay - by, az - bz, aw - bw)
    angle = 2.0 * math.atan2(apart, math.hypot(ax + bx, ay + by, az + bz, aw + bw))
    sine = math.sin(angle)
    rest = 1.0 - share
    if sine > 1e-12:
        a, b = math.sin(rest * angle) / sine, math.sin(share * angle) / sine
    else:
        a, b = rest, share
    return (
        rest * px + share * x,
        rest * py + share * y,
        rest * pz + share * z,
        a * ax + b * bx,
        a * ay + b * by,
        a * az + b * bz,
        a * aw + b * bw,
    )


def unit(quaternion: Sequence[float]) -> tuple[float, float, float, float]:
    """Return a quaternion (4,) normalized to length 1.

    Raises:
        NotAPose: its length is not close to 1.
    """
    x, y, z, w = map(float, quaternion)
    length = math.hypot(x, y, z, w)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        hint = "; all 0: the field was never set" if length == 0 else ""
        raise NotAPose(
            f"expected a unit quaternion (x, y, z, w); got {(x, y, z, w)}, whose length is {length:.6g}{hint}"
        )
    return x / length, y / length, z / length, w / length


def _all_finite(*numbers: float) -> bool:
    return all(map(math.isfinite, numbers))


def _refuse(translation: tuple[float, float, float]) -> RigidTransform:
    raise NotAPose(f"expected finite numbers as translation; got {translation}")
