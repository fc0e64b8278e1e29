"""Rotations as matrices and quaternions."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


def quaternion_of(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternion (4,), x, y, z, w, of a rotation matrix (3, 3)."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(), np.float64)


def upright_pose(place_m: Sequence[float], yaw_rad: float) -> NDArray[np.float64]:
    """Return the pose (4, 4) of what stands upright at a place (3,), m, turned about the vertical."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    pose = np.eye(4)
    pose[:2, :2] = [[cos, -sin], [sin, cos]]
    pose[:3, 3] = place_m
    return pose
