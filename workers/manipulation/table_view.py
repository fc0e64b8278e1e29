"""Finds a table and what stands on it in a depth image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull

from robbie_robots.workers.manipulation.collisions import Shape
from robbie_robots.workers.manipulation.object_names import ObjectNamer, Prints
from robbie_robots.workers.manipulation.rotations import upright_pose

Floats = NDArray[np.float64]

PLANE_TRIES = 60
PLANE_M = 0.008
"""Points this near to the plane belong to the table."""
LEVEL_RAD = 0.1
MIN_TABLE_POINTS = 400
ABOVE_M = 0.012
MIN_POINTS = 25
CELL_M = 0.01
TOP_M = 0.012
"""Points at most this far below an object's highest ones show its outline."""
TABLE = "table"
UNKNOWN = "unknown"


@dataclass(frozen=True)
class KnownObject:
    """An object that the robot can name by its shape.

    Attributes:
        name: its name.
        size_m: extent in x, y and z when it stands; the x and y of a can are its diameter.
        is_round: whether it is an upright cylinder.
    """

    name: str
    size_m: tuple[float, float, float]
    is_round: bool


@dataclass(frozen=True)
class TableRegion:
    """The space in front of the robot in which it looks for a table: least and greatest x, y, z; m."""

    least_m: tuple[float, float, float] = (0.2, -0.7, 0.15)
    most_m: tuple[float, float, float] = (1.3, 0.7, 0.95)


@dataclass(frozen=True)
class TableView:
    """A table and what stands on it, in the base's frame.

    Attributes:
        stamp_s: when the image was taken.
        table: a box from the floor to the table's top, turned as the table is; it covers what was seen of it.
        objects: what stands there; names that are not known begin with UNKNOWN.
    """

    stamp_s: float
    table: Shape
    objects: tuple[Shape, ...]

    @property
    def top_m(self) -> float:
        """Return the height of the table's top."""
        return float(self.table.pose[2, 3]) + self.table.size_m[2] / 2

    def named(self, name: str) -> Shape | None:
        """Return the object of a name."""
        return next((shape for shape in self.objects if shape.name == name), None)


class TableFinder:
    """Finds a level plane by RANSAC (Fischler and Bolles, 1981), and clusters what is above it.

    Args:
        known: objects that it can name by their size.
        tolerance_m: largest difference between the measured and the known size.
        seed: random seed of the planes that it tries.
        certain: minimum confidence with which a print is recognized.

    Attributes:
        namer: gives the names.
    """

    def __init__(
        self,
        known: Sequence[KnownObject],
        tolerance_m: float = 0.015,
        seed: int = 0,
        certain: float = 0.7,
    ) -> None:
        self.namer = ObjectNamer((one.name for one in known), certain)
        self._known = tuple(known)
        self._region = TableRegion()
        self._tolerance_m = tolerance_m
        self._chance = np.random.default_rng(seed)

    def find(
        self, points: Floats, stamp_s: float, pixel_rad: float, eye: Floats, prints: Prints | None = None
    ) -> TableView | None:
        """Return the table and its objects; None without a table.

        Args:
            points: (N, 3), m, base's frame: what the camera measured.
            stamp_s: when.
            pixel_rad: angle between neighbouring pixels.
            eye: (3,), m, base's frame: where the camera is.
            prints: what was recognized in a colour picture of the same time.
        """
        within = ((points > self._region.least_m) & (points < self._region.most_m)).all(axis=1)
        points = points[within]
        top_m = self._top(points)
        if top_m is None:
            return None
        top = _top_points(points, top_m)
        if len(top) < MIN_TABLE_POINTS:
            return None
        table = _table_box(top, top_m)
        on_table = (points[:, :2] - table.pose[:2, 3]) @ table.pose[:2, :2]
        inside = (np.abs(on_table) < np.array(table.size_m[:2]) / 2).all(axis=1)
        above = points[inside & (points[:, 2] > top_m + ABOVE_M)]
        clusters = _clusters(above)
        seen = [
            _measured(cluster, top_m, pixel_rad * float(np.linalg.norm(cluster.mean(axis=0) - eye)))
            for cluster in clusters
        ]
        like = [self._of_size(shape.size_m) for shape in seen]
        names = self.namer.names(clusters, [[known.name for known in possible] for possible in like], prints)
        objects = [
            _named(shape, name or f"{UNKNOWN} {number}", possible, top_m)
            for number, (shape, name, possible) in enumerate(zip(seen, names, like, strict=True))
        ]
        return TableView(stamp_s, table, tuple(objects))

    def _top(self, points: Floats) -> float | None:
        """Return the height of the level plane with the most points."""
        if len(points) < MIN_TABLE_POINTS:
            return None
        best, best_count = None, MIN_TABLE_POINTS - 1
        for _ in range(PLANE_TRIES):
            a, b, c = points[self._chance.integers(len(points), size=3)]
            normal = np.cross(b - a, c - a)
            length = float(np.linalg.norm(normal))
            if length < 1e-5 or abs(normal[2]) < math.cos(LEVEL_RAD) * length:
                continue
            near = np.abs((points - a) @ (normal / length)) < PLANE_M
            if np.count_nonzero(near) > best_count:
                best, best_count = near, int(np.count_nonzero(near))
        return None if best is None else float(np.median(points[best, 2]))

    def _of_size(self, size_m: tuple[float, float, float]) -> list[KnownObject]:
        """Return the known objects of about this size (long, short, height), the most like first."""
        worst_m = {}
        for known in self._known:
            x, y, z = known.size_m
            wanted = (max(x, y), min(x, y), z)
            worst_m[known] = max(abs(one - other) for one, other in zip(size_m, wanted, strict=True))
        return sorted((one for one in worst_m if worst_m[one] <= self._tolerance_m), key=worst_m.__getitem__)


def points_of(depth_mm: NDArray[np.uint16], focal_px: float, centre_px: tuple[float, float]) -> Floats:
    """Return what a depth image shows: (N, 3), m, in the camera's frame (z ahead, x right, y down)."""
    rows, columns = np.nonzero(depth_mm)
    depths = depth_mm[rows, columns] / 1000.0
    x = (columns - centre_px[0]) / focal_px * depths
    y = (rows - centre_px[1]) / focal_px * depths
    return np.column_stack([x, y, depths])


def _measured(cluster: Floats, top_m: float, spacing_m: float) -> Shape:
    """Return the box around a cluster, with its long side as x, whose points are this far apart."""
    height_m = float(np.percentile(cluster[:, 2], 98)) - top_m
    outline = cluster[cluster[:, 2] > top_m + height_m - TOP_M, :2]
    (x, y), (long_m, short_m), yaw_rad = smallest_rectangle(outline)
    pose = upright_pose((x, y, top_m + height_m / 2), yaw_rad)
    return Shape(UNKNOWN, (long_m + spacing_m, short_m + spacing_m, height_m), pose)


def _named(seen: Shape, name: str, like: Sequence[KnownObject], top_m: float) -> Shape:
    """Return an object with its name, and with the exact size if objects of its size are known."""
    if not like:
        return Shape(name, seen.size_m, seen.pose)
    known = next((one for one in like if one.name == name), like[0])
    pose = seen.pose.copy()
    pose[2, 3] = top_m + known.size_m[2] / 2
    if known.size_m[0] < known.size_m[1]:  # its x is the short side
        pose[:3, 0], pose[:3, 1] = seen.pose[:3, 1], -seen.pose[:3, 0]
    return Shape(name, known.size_m, pose, known.is_round)


def smallest_rectangle(points: Floats) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Return the middle, the long and the short side, and the long side's direction, of the rectangle.

    It is the one with the smallest area, of those in steps of one degree.

    Args:
        points: (N, 2), m.
    """
    angles = np.radians(np.arange(0.0, 90.0, 1.0))
    along = points @ np.stack([np.cos(angles), np.sin(angles)])
    across = points @ np.stack([-np.sin(angles), np.cos(angles)])
    lengths, widths = np.ptp(along, axis=0), np.ptp(across, axis=0)
    best = int((lengths * widths).argmin())
    angle = float(angles[best])
    u = (along[:, best].min() + along[:, best].max()) / 2
    v = (across[:, best].min() + across[:, best].max()) / 2
    middle = (u * math.cos(angle) - v * math.sin(angle), u * math.sin(angle) + v * math.cos(angle))
    length, width = float(lengths[best]), float(widths[best])
    if width > length:
        return middle, (width, length), angle + math.pi / 2
    return middle, (length, width), angle


def _top_points(points: Floats, top_m: float) -> Floats:
    """Return the points of a table's top, without those of a wall behind it at the same height."""
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / CELL_M).astype(np.intp)
    is_high = points[:, 2] > top_m + ABOVE_M
    high = np.zeros(cells.max(axis=0) + 1, bool)
    high[cells[is_high, 0], cells[is_high, 1]] = True
    high = ndimage.binary_dilation(high, np.ones((3, 3), bool))
    is_top = (np.abs(points[:, 2] - top_m) < PLANE_M) & ~high[cells[:, 0], cells[:, 1]]
    top: Floats = points[is_top]
    return top


def _table_box(flat: Floats, top_m: float) -> Shape:
    """Return a box under the points of a table's top: the smallest one, so that all of it is table."""
    # Single points beyond the edge, at the side of an object or far away, do not count.
    least, most = np.percentile(flat[:, :2], 0.5, axis=0), np.percentile(flat[:, :2], 99.5, axis=0)
    seen = flat[((flat[:, :2] >= least) & (flat[:, :2] <= most)).all(axis=1), :2]
    (x, y), size_m, yaw_rad = smallest_rectangle(seen[ConvexHull(seen).vertices])
    return Shape(TABLE, (*size_m, top_m), upright_pose((x, y, top_m / 2), yaw_rad))


def _clusters(points: Floats) -> list[Floats]:
    """Return the points of each group, seen from above, the nearest first."""
    if not len(points):
        return []
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / CELL_M).astype(np.intp)
    grid = np.zeros(cells.max(axis=0) + 1, bool)
    grid[cells[:, 0], cells[:, 1]] = True
    labels, count = ndimage.label(grid, np.ones((3, 3)))
    of_point = labels[cells[:, 0], cells[:, 1]]
    groups = [points[of_point == label] for label in range(1, count + 1)]
    return sorted((one for one in groups if len(one) >= MIN_POINTS), key=lambda one: float(one[:, 0].min()))
