"""Poses in the plane, the group SE(2), as arrays `(..., 3) float64`: x (m), y (m), heading (rad)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def wrap_angle(angle_rad: Array) -> Array:
    """Wrap angles into [-pi, pi)."""
    wrapped: Array = (angle_rad + np.pi) % (2 * np.pi) - np.pi
    return wrapped


def compose(first: ArrayLike, second: ArrayLike) -> Array:
    """Transform `second` from the frame of `first` into the frame in which `first` is given."""
    first, second = np.asarray(first, float), np.asarray(second, float)
    cos, sin = np.cos(first[..., 2]), np.sin(first[..., 2])
    x = first[..., 0] + cos * second[..., 0] - sin * second[..., 1]
    y = first[..., 1] + sin * second[..., 0] + cos * second[..., 1]
    return np.stack([x, y, wrap_angle(first[..., 2] + second[..., 2])], axis=-1)


def relative(base: ArrayLike, pose: ArrayLike) -> Array:
    """Return `pose` relative to `base` (both given in the same frame)."""
    base, pose = np.asarray(base, float), np.asarray(pose, float)
    cos, sin = np.cos(base[..., 2]), np.sin(base[..., 2])
    dx, dy = pose[..., 0] - base[..., 0], pose[..., 1] - base[..., 1]
    return np.stack(
        [cos * dx + sin * dy, cos * dy - sin * dx, wrap_angle(pose[..., 2] - base[..., 2])], axis=-1
    )


def transform_points(pose: ArrayLike, points: ArrayLike) -> Array:
    """Transform points `(N, 2)`, m, from the frame of `pose` into the frame in which the pose is given."""
    pose, points = np.asarray(pose, float), np.asarray(points, float)
    moved: Array = rotate(pose[2], points) + pose[:2]
    return moved


def rotate(angle_rad: float, vectors: ArrayLike) -> Array:
    """Rotate vectors `(N, 2)` by an angle."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turned: Array = np.asarray(vectors, float) @ np.array([[cos, sin], [-sin, cos]])
    return turned


def rotated_information(information: ArrayLike, angle_rad: float) -> Array:
    """Rotate a pose's inverse covariance `(3, 3)` into the frame in which its own frame has this angle."""
    turn = np.eye(3)
    turn[:2, :2] = rotate(angle_rad, np.eye(2)).T
    turned: Array = turn @ np.asarray(information, float) @ turn.T
    return turned
