"""Points on surfaces with the direction that each surface faces, for scan matching."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.planar_pose import relative, rotate, transform_points

NEIGHBOURS_EACH_SIDE = 6
SMALLEST_REACH_M = 0.2
REACH_PER_RANGE = 0.06  # far beams are far apart on a wall seen at a grazing angle,
REACH_BEAMS = 3.4  # and so are those of a coarse laser: the reach is at least this many of its beams
FEWEST_OF_A_LINE = 3
FLATNESS = 0.1  # greatest share of the spread across a surface to that along it
GRAZING = 5  # successive points that show a wall at which the beams graze, however far apart they are,
GRAZING_GROWTH = 2.5  # if each gap is at most this many times the next one
GRAZING_NOISE_M = 0.03  # and they lie on a line, up to this standard deviation
FILLED_M, FILLING_M = 3.0, 0.15  # widest gap filled in a wall, and the distance of the points there
NARROW_M = 0.4  # a leg or a person is at most this wide
APART_M, APART_PER_RANGE = 0.25, 0.06  # successive returns farther apart are of two things
ONE_WALL = 0.97  # least cosine between the normals of two points of one wall


@dataclass(frozen=True)
class SurfacePoints:
    """Points where beams ended, and the normal of the surface there.

    Attributes:
        points: `(N, 2) float64`, m.
        normals: `(N, 2) float64`, unit vectors to the side it was seen from; zero where
            no surface is recognised.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]

    @staticmethod
    def from_bearings(
        bearings_rad: NDArray[np.float64], ranges_m: NDArray[np.float64], step_rad: float
    ) -> "SurfacePoints":
        """Take the ends of beams, in the order they were swept, in the laser's frame.

        Args:
            bearings_rad: `(N,)`, directions of the beams that returned.
            ranges_m: `(N,)`.
            step_rad: From one of the laser's beams to the next.
        """
        points = ranges_m[:, None] * np.column_stack([np.cos(bearings_rad), np.sin(bearings_rad)])
        reach = np.maximum(SMALLEST_REACH_M, max(REACH_PER_RANGE, REACH_BEAMS * step_rad) * ranges_m)
        return SurfacePoints(points, _normals(points, reach))

    def moved(self, pose: ArrayLike) -> "SurfacePoints":
        """Transform the points into the frame in which `pose` is given."""
        heading = float(np.asarray(pose)[2])
        return SurfacePoints(transform_points(pose, self.points), rotate(heading, self.normals))

    def seen_from(self, pose: ArrayLike) -> "SurfacePoints":
        """Transform the points from the frame in which `pose` is given into the frame of `pose`."""
        return self.moved(relative(pose, np.zeros(3)))

    def thinned(self, most: int) -> "SurfacePoints":
        """Drop points evenly until at most `most` are left."""
        every = -(-len(self) // most)
        return SurfacePoints(self.points[::every], self.normals[::every])

    def narrow(self) -> NDArray[np.bool_]:
        """Return which points `(N,)` of a sweep show a narrow thing, such as a leg, and not a wall.

        A wall at which the beams graze is also seen as single points.
        """
        if not len(self):
            return np.zeros(0, np.bool_)
        gap = np.diff(self.points, axis=0)
        reach = np.maximum(APART_M, APART_PER_RANGE * np.hypot(*self.points.T))
        begins = np.hypot(*gap.T) > np.minimum(reach[:-1], reach[1:])
        first = np.concatenate([[0], np.flatnonzero(begins) + 1])
        last = np.append(first[1:], len(self)) - 1
        wide_m = np.hypot(*(self.points[last] - self.points[first]).T)
        count = last - first + 1
        is_grazed = np.repeat(count < FEWEST_OF_A_LINE, count) & self.normals.any(axis=1)
        return np.asarray(np.repeat(wide_m < NARROW_M, count) & ~is_grazed)

    def filled(self) -> "SurfacePoints":
        """Add points in the gaps of walls on which successive beams are far apart.

        Otherwise, the ends of beams that graze a wall look like things that move with the robot.
        """
        gap = np.diff(self.points, axis=0)
        gap_m = np.hypot(gap[:, 0], gap[:, 1])
        begin, end = self.normals[:-1], self.normals[1:]
        is_wall = np.einsum("ni,ni->n", begin, end) > ONE_WALL
        off = np.maximum(*np.abs([np.einsum("ni,ni->n", gap, normal) for normal in (begin, end)]))
        is_wall &= (off < np.sqrt(1 - ONE_WALL**2) * gap_m) & (gap_m > FILLING_M) & (gap_m < FILLED_M)
        rows = np.flatnonzero(is_wall)
        parts = np.ceil(gap_m[rows] / FILLING_M).astype(np.int64)
        row = np.repeat(rows, parts - 1)
        share = np.concatenate([np.arange(1, count) / count for count in parts] or [np.zeros(0)])[:, None]
        points = self.points[row] + share * gap[row]
        return SurfacePoints.joined([self, SurfacePoints(points, self.normals[row])])

    def chosen(self, rows: NDArray[np.bool_]) -> "SurfacePoints":
        """Return the points of these rows `(N,)`."""
        return SurfacePoints(self.points[rows], self.normals[rows])

    def __len__(self) -> int:
        return len(self.points)

    @staticmethod
    def joined(scans: "list[SurfacePoints]") -> "SurfacePoints":
        """Concatenate scans given in one frame."""
        return SurfacePoints(
            np.concatenate([scan.points for scan in scans]), np.concatenate([scan.normals for scan in scans])
        )


def _normals(points: NDArray[np.float64], reach: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit a line through each point's neighbours in the sweep within its reach (by principal components)."""
    moments = np.zeros((len(points), 6))  # count, x, y, xx, xy, yy of the neighbours, seen from the point
    moments[:, 0] = 1.0
    for shift in range(1, min(NEIGHBOURS_EACH_SIDE, len(points) - 1) + 1):
        step = points[shift:] - points[:-shift]
        near = (np.hypot(step[:, 0], step[:, 1]) < np.minimum(reach[shift:], reach[:-shift])).astype(float)
        x, y = step[:, 0] * near, step[:, 1] * near
        even = np.column_stack([near, x, y, x * x, x * y, y * y])
        moments[:-shift] += even
        moments[shift:] += even * [1, -1, -1, 1, 1, 1]
    count, x, y, xx, xy, yy = moments.T
    xx, xy, yy = xx - x * x / count, xy - x * y / count, yy - y * y / count
    heading = 0.5 * np.arctan2(2 * xy, xx - yy)  # of the surface
    spread, middle = np.hypot((xx - yy) / 2, xy), (xx + yy) / 2
    known = (count >= FEWEST_OF_A_LINE) & (middle - spread < FLATNESS * (middle + spread))
    normals = np.column_stack([-np.sin(heading), np.cos(heading)]) * known[:, None]
    normals = np.where(known[:, None], normals, _grazed(points))
    normals[np.einsum("ij,ij->i", normals, points) > 0] *= -1
    return normals


def _grazed(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the normals of walls at which the beams graze, for each of `GRAZING` points; else zero."""
    normals = np.zeros_like(points)
    if len(points) < GRAZING:
        return normals
    groups = np.lib.stride_tricks.sliding_window_view(points, GRAZING, axis=0)  # (M, 2, GRAZING)
    gap_m = np.hypot(*np.moveaxis(np.diff(groups, axis=2), 1, 0))
    growth = gap_m[:, 1:] / np.maximum(gap_m[:, :-1], 1e-6)
    is_even = ((growth < GRAZING_GROWTH) & (growth > 1 / GRAZING_GROWTH)).all(axis=1)
    off = groups[is_even] - groups[is_even].mean(axis=2, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("mik,mjk->mij", off, off) / GRAZING)
    is_line = (spread[:, 0] < GRAZING_NOISE_M**2) & (spread[:, 0] < FLATNESS**2 * spread[:, 1])
    first = np.flatnonzero(is_even)[is_line]
    for place in np.argsort(-np.abs(np.arange(GRAZING) - GRAZING // 2), kind="stable"):  # the middle last
        normals[first + place] = axes[is_line, :, 0]
    return normals
