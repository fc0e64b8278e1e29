"""Boxes and cylinders in space: what simulated arms grasp and touch, and what simulated depth cameras see."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Solid:
    """A box, or a cylinder about its z axis; its frame is in its middle.

    Attributes:
        size_m: extent in x, y and z; the x and y of a cylinder are its diameter.
        is_round: whether it is a cylinder.
    """

    size_m: tuple[float, float, float]
    is_round: bool = False

    def contains(self, points: Floats, deeper_than_m: float = 0.0) -> NDArray[np.bool_]:
        """Return which points are within.

        Args:
            points: (N, 3), m, its own frame.
            deeper_than_m: points nearer to the surface than this are not within.
        """
        half = np.array(self.size_m) / 2 - deeper_than_m
        if self.is_round:
            within = np.hypot(points[:, 0], points[:, 1]) < half[0]
            return np.asarray(within & (np.abs(points[:, 2]) < half[2]))
        return np.asarray((np.abs(points) < half).all(axis=1))

    def surface(self, step_m: float) -> Floats:
        """Return points of its surface about this far apart: (N, 3), m, its own frame."""
        x, y, z = self.size_m
        heights = _between(z, step_m)
        if self.is_round:
            angles = np.linspace(0.0, 2 * math.pi, max(8, math.ceil(math.pi * x / step_m)), endpoint=False)
            ring = np.column_stack([np.cos(angles), np.sin(angles)])
            side = np.column_stack([np.tile(ring * x / 2, (len(heights), 1)), np.repeat(heights, len(ring))])
            radii = np.arange(x / 2, 0.0, -step_m)
            flat = np.concatenate([ring * radius for radius in radii])
            caps = [np.column_stack([flat, np.full(len(flat), end)]) for end in (-z / 2, z / 2)]
            return np.concatenate([side, *caps])
        sides = [_between(length, step_m) for length in self.size_m]
        faces = []
        for axis, length in enumerate((x, y, z)):
            first, second = (sides[other] for other in range(3) if other != axis)
            grid = np.array(np.meshgrid(first, second)).reshape(2, -1).T
            faces += [np.insert(grid, axis, end, axis=1) for end in (-length / 2, length / 2)]
        return np.concatenate(faces)

    def ranges_m(self, origin: Floats, directions: Floats) -> Floats:
        """Return the lengths of rays from one point, in units of the directions, to where they enter.

        Args:
            origin: (3,), m, its own frame.
            directions: (N, 3), its own frame.

        Returns:
            (N,); +inf for a ray that misses it or begins within it.
        """
        half = np.array(self.size_m) / 2
        with np.errstate(divide="ignore", invalid="ignore"):  # a ray may be parallel to a face
            one, other = (-half - origin) / directions, (half - origin) / directions
        first, last = np.minimum(one, other), np.maximum(one, other)
        first, last = np.nan_to_num(first, nan=-np.inf), np.nan_to_num(last, nan=np.inf)
        if self.is_round:
            enter, leave = _through_circle(origin, directions, half[0])
            enter, leave = np.maximum(enter, first[:, 2]), np.minimum(leave, last[:, 2])
        else:
            enter, leave = first.max(axis=1), last.min(axis=1)
        return np.where((enter <= leave) & (enter > 0.0), enter, np.inf)


class Placed(NamedTuple):
    """A solid and X_AS, its pose in the arena: (4, 4)."""

    solid: Solid
    pose: Floats

    @property
    def radius_m(self) -> float:
        """Radius of a sphere about its middle that contains it."""
        return math.hypot(*self.solid.size_m) / 2

    def contains(self, points: Floats, deeper_than_m: float = 0.0) -> NDArray[np.bool_]:
        """Return which points (N, 3), m, arena frame, are within; see `Solid.contains`."""
        rotation, place = self.pose[:3, :3], self.pose[:3, 3]
        return self.solid.contains((points - place) @ rotation, deeper_than_m)

    def is_near(self, other: "Placed", apart_m: float = 0.0) -> bool:
        """Return whether the two may be nearer to each other than this."""
        reach_m = self.radius_m + other.radius_m + apart_m
        return float(((self.pose[:3, 3] - other.pose[:3, 3]) ** 2).sum()) < reach_m**2


def moved(pose: Floats, points: Floats) -> Floats:
    """Return points (N, 3) of a frame in the frame in which it has this pose (4, 4)."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def pose_at(xyz_m: tuple[float, float, float], yaw_rad: float = 0.0) -> Floats:
    """Return the pose (4, 4) of what stands at a place, turned about the vertical."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    pose = np.eye(4)
    pose[:2, :2] = [[cos, -sin], [sin, cos]]
    pose[:3, 3] = xyz_m
    return pose


def _between(length_m: float, step_m: float) -> Floats:
    return np.linspace(-length_m / 2, length_m / 2, max(2, math.ceil(length_m / step_m) + 1))


def _through_circle(origin: Floats, directions: Floats, radius_m: float) -> tuple[Floats, Floats]:
    """Return where rays enter and leave an endless cylinder about z: (N,) each; enter > leave: never."""
    a = (directions[:, :2] ** 2).sum(axis=1)
    b = directions[:, :2] @ origin[:2]
    c = float(origin[:2] @ origin[:2]) - radius_m**2
    root = b * b - a * c
    is_through = (root > 0.0) & (a > 1e-12)
    half = np.sqrt(np.where(is_through, root, 0.0))
    safe = np.where(is_through, a, 1.0)
    # A ray along the axis is within it from end to end, or never.
    along = np.inf if c < 0 else -np.inf
    miss = np.where(a > 1e-12, -np.inf, along)
    return np.where(is_through, (-b - half) / safe, -miss), np.where(is_through, (-b + half) / safe, miss)
