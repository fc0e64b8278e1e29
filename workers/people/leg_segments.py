"""Segments of a laser scan, and the features by which legs differ from other things.

The features are a choice of those of Arras, Mozos and Burgard, "Using boosted features for the detection of
people in 2D range data" (ICRA 2007).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep

Array = NDArray[np.float64]
Places = NDArray[np.intp]

FEATURES = (
    "points",
    "width_m",
    "apparent_width_m",
    "spread_m",
    "thickness_m",
    "roundness",
    "circle_radius_m",
    "circle_residual_m",
    "convexity_m",
    "boundary_ratio",
    "boundary_deviation_m",
    "range_m",
    "jump_before_m",
    "jump_after_m",
)
GAP_M = 0.12
"""Neighbouring returns that are farther apart belong to different segments."""
MAX_WIDTH_M = 0.5
"""Wider segments are no legs."""
FEWEST_POINTS = 3
MAX_JUMP_M, MAX_RADIUS_M = 1.0, 1.0


class Segments(NamedTuple):
    """Parts of a scan that are as wide as legs or less.

    Attributes:
        centres_m: (N, 2), where the middle of a leg would be, in the laser's frame.
        features: (N, len(FEATURES)).
        beams: (N, 2), the first and the last beam; in a full scan, the last one may come first.
    """

    centres_m: Array
    features: Array
    beams: Places


def find_segments(sweep: LaserSweep, max_range_m: float) -> Segments:
    """Cut a sweep into segments. Returns farther than `max_range_m` are not used."""
    pieces = cut_scan(sweep, max_range_m)
    if len(pieces.beams) < FEWEST_POINTS:
        return Segments(np.empty((0, 2)), np.empty((0, len(FEATURES))), np.empty((0, 2), np.intp))
    first, last = pieces.ends.T
    kept = (last - first + 1 >= FEWEST_POINTS) & (pieces.widths_m <= MAX_WIDTH_M)
    jumps = np.clip(pieces.jumps_m, -MAX_JUMP_M, MAX_JUMP_M)
    centres, features = _described(pieces.points, first, last, kept, jumps, sweep.angle_increment_rad)
    return Segments(centres, features, pieces.beams[pieces.ends[kept]])


class Pieces(NamedTuple):
    """A scan cut where neighbouring returns are far apart.

    Attributes:
        beams: (P,), the beam of each return.
        points: (P, 2), m, where the returns are, in the laser's frame.
        ends: (S, 2), positions of each piece's first and last return in `beams` and `points`.
        jumps_m: (2, S), how much farther the beams before and after each piece reach; negative: something
            hides it.
    """

    beams: Places
    points: Array
    ends: Places
    jumps_m: Array

    @property
    def widths_m(self) -> Array:
        """Return the distance from the first to the last return of each piece: (S,)."""
        first, last = self.ends.T
        width: Array = np.hypot(*(self.points[last] - self.points[first]).T)
        return width

    @property
    def middles_m(self) -> Array:
        """Return the point between the first and the last return of each piece: (S, 2)."""
        middles: Array = self.points[self.ends].mean(axis=1)
        return middles


def cut_scan(sweep: LaserSweep, max_range_m: float, gap_m: float = GAP_M) -> Pieces:
    """Cut a sweep where neighbouring returns are farther apart than `gap_m`; else as `find_segments`."""
    ranges, directions = sweep.ranges_m, sweep.directions
    shift = 0
    if len(ranges) * sweep.angle_increment_rad > 2 * np.pi - 1.5 * sweep.angle_increment_rad:
        shift = _cut(ranges)  # so that no piece is cut at the scan's ends
        ranges, directions = np.roll(ranges, -shift), np.roll(directions, -shift, axis=0)
    beams = np.flatnonzero(np.isfinite(ranges) & (ranges > 0.0) & (ranges < max_range_m))
    if not len(beams):
        none = np.empty(0, np.intp)
        return Pieces(none, np.empty((0, 2)), np.empty((0, 2), np.intp), np.empty((2, 0)))
    points = ranges[beams, None] * directions[beams]
    apart = np.hypot(*np.diff(points, axis=0).T)
    first = np.concatenate([[0], np.flatnonzero((apart > gap_m) | (np.diff(beams) > 2)) + 1])
    last = np.concatenate([first[1:], [len(beams)]]) - 1
    background = np.where(np.isnan(ranges), np.inf, ranges)
    before = background[beams[first] - 1] - background[beams[first]]
    after = background[(beams[last] + 1) % len(background)] - background[beams[last]]
    ends = np.column_stack([first, last])
    return Pieces((beams + shift) % len(ranges), points, ends, np.stack([before, after]))


def _cut(ranges: Array) -> int:
    """Return the beam that begins after the largest jump of range."""
    filled = np.where(np.isfinite(ranges), ranges, 100.0)
    return int(np.argmax(np.abs(filled - np.roll(filled, 1))))


def _described(
    points: Array,
    first: Places,
    last: Places,
    kept: NDArray[np.bool_],
    jumps: Array,
    increment_rad: float,
) -> tuple[Array, Array]:
    """Compute middles and features of the segments that are kept, all at once."""
    count = (last - first + 1).astype(np.float64)

    def sums(values: Array) -> Array:
        total: Array = np.add.reduceat(values, first, axis=0)
        return total

    def means(values: Array) -> Array:
        return sums(values) / count.reshape(-1, *[1] * (values.ndim - 1))

    centroid = means(points)
    number = np.repeat(np.arange(len(first)), count.astype(np.intp))
    offset = points - centroid[number]
    xx, yy, xy = means(offset[:, 0] ** 2), means(offset[:, 1] ** 2), means(offset[:, 0] * offset[:, 1])
    half, root = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    small, large = np.maximum(half - root, 0.0), half + root
    middle, radius, residual = _circles(offset, number, means)
    distance = np.hypot(*centroid.T)
    toward = -centroid / np.maximum(distance, 1e-6)[:, None]
    ends = (points[first] + points[last]) / 2
    convexity = ((centroid - ends) * toward).sum(axis=1)
    steps = np.append(np.hypot(*np.diff(points, axis=0).T), 0.0)
    steps[last] = 0.0
    inner = np.maximum(count - 1, 1)
    step = sums(steps) / inner
    deviation = np.sqrt(np.maximum(sums(steps**2) / inner - step**2, 0.0))
    chord = np.hypot(*(points[last] - points[first]).T)
    features = np.column_stack(
        [
            count,
            chord,
            count * increment_rad * distance,
            np.sqrt(xx + yy),
            np.sqrt(small),
            np.sqrt(small / np.maximum(large, 1e-9)),
            radius,
            residual,
            convexity,
            np.minimum(sums(steps) / np.maximum(chord, 1e-3), 10.0),
            deviation,
            distance,
            *jumps,
        ]
    )
    # The laser sees the front of a leg: its middle lies behind the returns.
    fits = (radius < 0.12)[:, None] & (np.hypot(*middle.T) < 0.12)[:, None]
    centres = centroid + np.where(fits, middle, -0.03 * toward)
    return centres[kept], features[kept]


def _circles(offset: Array, number: Places, means: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
    """Fit a circle to each segment (Kåsa 1976): its middle from the centroid, radius, and residual."""
    x, y = offset.T
    square = x**2 + y**2
    a, b, c = means(x * x), means(x * y), means(y * y)
    d, e = means(square * x) / 2, means(square * y) / 2
    # A little is added to the diagonal, so that a straight segment gets a large circle instead of none.
    a, c = a + 1e-7, c + 1e-7
    area = np.maximum(a * c - b * b, 1e-14)
    middle = np.column_stack([(d * c - e * b) / area, (e * a - d * b) / area])
    radius = np.sqrt(means(square) + (middle**2).sum(axis=1))
    off = np.hypot(*(offset - middle[number]).T) - radius[number]
    return middle, np.minimum(radius, MAX_RADIUS_M), np.minimum(np.sqrt(means(off**2)), 1.0)
