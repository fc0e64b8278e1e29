"""Rotations as matrices and quaternions."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


def quaternion_of(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternion (4,), x, y, z, w, of a rotation matrix (3, 3)."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(), np.float64)
