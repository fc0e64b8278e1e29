"""One sweep of a planar laser: the points it hit and the space it saw as free."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.surface_points import SurfacePoints

CLEARANCE_M = 0.3  # a place that is nearer than the hit by this much counts as seen free
MAX_TURNS = 2.0  # beams may overlap; directions that go round more often are in another unit, or damaged
ONE_BEAM_RAD = np.pi / 180  # the width of a beam that is alone
LEAST_WIDE = 0.3  # share of the returns; of fewer on wide things, nothing follows
GEOMETRIES = 16  # kept directions; a robot has few lasers, but some change their geometry with each sweep


@dataclass(frozen=True)
class LaserSweep:
    """A sweep in the laser's own frame, counter-clockwise, as `from_ranges` checks it.

    Every sweep has its own geometry, because lasers may be exchanged, and the number of beams of a spinning
    one varies.

    Attributes:
        ranges_m: `(N,)`, m, by REP 117: +inf for no return, -inf for something too near to measure, NaN for a
            beam that was not measured.
        angle_min_rad: Bearing of the first beam.
        angle_increment_rad: From one beam to the next; positive.
        range_max_m: Farther returns were not measured.
        problem: Why the sweep is unusable; '' if it is not. An unusable sweep has no beams, which does not
            mean that anything is free: a robot must treat it like no sweep.
    """

    ranges_m: NDArray[np.float64]
    angle_min_rad: float
    angle_increment_rad: float
    range_max_m: float = np.inf
    problem: str = ""

    @staticmethod
    def from_ranges(
        ranges_m: ArrayLike,
        angle_min_rad: float,
        angle_increment_rad: float,
        range_min_m: float,
        range_max_m: float,
    ) -> "LaserSweep":
        """Take a sweep's ranges `(N,)`, m, with its geometry; an upside-down laser has a negative increment.

        Nearer than range_min_m counts as too near to measure, range_max_m and farther as no return.
        """
        ranges = np.array(ranges_m, float)
        first, step = float(angle_min_rad), float(angle_increment_rad)
        problem = _problem(ranges, first, step, float(range_min_m), float(range_max_m))
        if problem:
            return LaserSweep(np.empty(0), 0.0, ONE_BEAM_RAD, problem=problem)
        if step < 0.0:
            ranges, first, step = ranges[::-1].copy(), first + (len(ranges) - 1) * step, -step
        ranges[ranges < range_min_m] = -np.inf
        ranges[ranges >= range_max_m] = np.inf
        return LaserSweep(ranges, first, step or ONE_BEAM_RAD, float(range_max_m))

    def __len__(self) -> int:
        return len(self.ranges_m)

    @property
    def bearings_rad(self) -> NDArray[np.float64]:
        """Direction of each beam: `(N,)`."""
        return self.angle_min_rad + self.angle_increment_rad * np.arange(len(self), dtype=np.float64)

    @property
    def directions(self) -> NDArray[np.float64]:
        """Direction of each beam: `(N, 2)`, unit vectors, read-only."""
        return _directions(self.angle_min_rad, self.angle_increment_rad, len(self))

    @cached_property
    def hits(self) -> SurfacePoints:
        """Where beams ended; computed on first use, so that a map is restored quickly."""
        returned = np.isfinite(self.ranges_m)
        bearings, ranges = self.bearings_rad[returned], self.ranges_m[returned]
        return SurfacePoints.from_bearings(bearings, ranges, self.angle_increment_rad)

    @cached_property
    def is_wide(self) -> NDArray[np.bool_]:
        """Which of the hits show walls and other wide things, and not people; all if those are too few."""
        is_wide = ~self.hits.narrow()
        return is_wide if is_wide.mean() >= LEAST_WIDE else np.ones_like(is_wide)

    @cached_property
    def walls(self) -> SurfacePoints:
        """Where beams ended, and what of a wall lies between them."""
        return self.hits.filled()

    def points(self, range_m: float = np.inf) -> NDArray[np.float64]:
        """Return the ends of the beams that ended nearer than `range_m`: `(K, 2)`, m."""
        near = np.isfinite(self.ranges_m) & (self.ranges_m < range_m)
        return self.ranges_m[near, None] * self.directions[near]

    def within(self, range_m: float) -> "LaserSweep":
        """Return the sweep of a laser that sees no farther than `range_m`."""
        if range_m >= self.range_max_m:
            return self
        ranges = np.where(self.ranges_m >= range_m, np.inf, self.ranges_m)
        return replace(self, ranges_m=ranges, range_max_m=range_m)

    def state(self) -> dict[str, Any]:
        """Return the sweep as it was measured; ranges as lasers give them, `float32`."""
        return {
            "ranges_m": self.ranges_m.astype(np.float32),
            "bearings_rad": (self.angle_min_rad, self.angle_increment_rad),
        }

    @staticmethod
    def from_state(state: Mapping[str, Any]) -> "LaserSweep":
        """Make the sweep that `state` was taken from."""
        angle_min_rad, angle_increment_rad = state["bearings_rad"]
        return LaserSweep.from_ranges(state["ranges_m"], angle_min_rad, angle_increment_rad, 0.0, np.inf)

    def beams_at(self, bearings_rad: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return which beam looks in each direction `(M,)`; a number >= len(self) if none does."""
        turned = (bearings_rad - self.angle_min_rad) % (2 * np.pi)
        beams = np.round(turned / self.angle_increment_rad).astype(np.int64)
        return np.where(turned > 2 * np.pi - self.angle_increment_rad / 2, 0, beams)

    def looked_through(self, places: ArrayLike) -> NDArray[np.bool_]:
        """Return which places `(M, 2)`, m, laser's frame, three adjacent beams saw as free."""
        places = np.asarray(places, float)
        if len(self) < 3:
            return np.zeros(len(places), np.bool_)
        beam = self.beams_at(np.arctan2(places[:, 1], places[:, 0]))
        inside: NDArray[np.bool_] = (beam >= 1) & (beam < len(self) - 1)
        beam = np.where(inside, beam, 1)
        ends_m = np.where(np.isfinite(self.ranges_m), self.ranges_m, np.nan)
        shortest = np.minimum(np.minimum(ends_m[beam - 1], ends_m[beam]), ends_m[beam + 1])
        free: NDArray[np.bool_] = np.hypot(places[:, 0], places[:, 1]) < shortest - CLEARANCE_M
        return inside & free


class UnusableSweeps:
    """Counts the unusable ones among a laser's sweeps, and remembers what the newest one lacks.

    Attributes:
        count: Number of unusable sweeps.
    """

    def __init__(self) -> None:
        self.count = 0
        self._problem = ""

    def passes(self, sweep: LaserSweep) -> bool:
        """Return whether a sweep can be used; count it if not."""
        self._problem = sweep.problem
        self.count += bool(sweep.problem)
        return not sweep.problem

    def __str__(self) -> str:
        if not self.count:
            return ""
        return f"; {self.count} unusable scans" + (f"; the newest: {self._problem}" if self._problem else "")


class MountedSweep(NamedTuple):
    """A sweep, and where on the robot its laser is mounted."""

    sweep: LaserSweep
    mount: ArrayLike = (0.0, 0.0, 0.0)
    """(x m, y m, heading rad), robot's frame."""


def _problem(ranges: NDArray[np.float64], first: float, step: float, least_m: float, most_m: float) -> str:
    """Return why a sweep is unusable; '' if it is not."""
    if ranges.ndim != 1 or len(ranges) == 0:
        return "it has no beams"
    if not np.isfinite(first) or not np.isfinite(step) or (step == 0.0 and len(ranges) > 1):
        return f"angle_min {first:g} and angle_increment {step:g} give its beams no directions"
    turns = abs(step) * (len(ranges) - 1) / (2 * np.pi)
    if turns > MAX_TURNS:
        return f"angle_increment {step:g} makes {len(ranges)} beams go round {turns:.1f} times"
    if not (most_m > 0.0 and most_m > least_m):
        return f"range_min {least_m:g} and range_max {most_m:g} have no range between them"
    return "none of its beams was measured (all are NaN)" if np.isnan(ranges).all() else ""


@lru_cache(maxsize=GEOMETRIES)
def _directions(first_rad: float, step_rad: float, beams: int) -> NDArray[np.float64]:
    bearings = first_rad + step_rad * np.arange(beams, dtype=np.float64)
    directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
    directions.setflags(write=False)
    return directions
