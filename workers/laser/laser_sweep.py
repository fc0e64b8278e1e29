"""One sweep of a planar laser: the points it hit and the space it saw as free."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.laser.surface_points import SurfacePoints

CLEARANCE_M = 0.3  # a place that is nearer than the hit by this much counts as seen free


@dataclass(frozen=True)
class LaserSweep:
    """A sweep in the laser's own frame.

    Attributes:
        ranges_m: `(N,)`, m; NaN for a beam without a return.
        angle_min_rad: Bearing of the first beam.
        angle_increment_rad: From one beam to the next.
    """

    ranges_m: NDArray[np.float64]
    angle_min_rad: float
    angle_increment_rad: float

    @staticmethod
    def from_ranges(
        ranges_m: ArrayLike,
        angle_min_rad: float,
        angle_increment_rad: float,
        range_min_m: float,
        range_max_m: float,
    ) -> "LaserSweep":
        """Take a sweep's ranges `(N,)`, m; those outside [range_min_m, range_max_m) count as no return."""
        ranges = np.array(ranges_m, float)
        with np.errstate(invalid="ignore"):
            ranges[~((ranges >= range_min_m) & (ranges < range_max_m))] = np.nan
        return LaserSweep(ranges, angle_min_rad, angle_increment_rad)

    @cached_property
    def hits(self) -> SurfacePoints:
        """Where beams ended; computed on first use, so that a map is restored quickly."""
        bearings = self.angle_min_rad + self.angle_increment_rad * np.arange(
            len(self.ranges_m), dtype=np.float64
        )
        returned = np.isfinite(self.ranges_m)
        return SurfacePoints.from_bearings(bearings[returned], self.ranges_m[returned])

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

    def looked_through(self, places: ArrayLike) -> NDArray[np.bool_]:
        """Return which places `(M, 2)`, m, laser's frame, three adjacent beams saw as free."""
        places = np.asarray(places, float)
        bearing = np.arctan2(places[:, 1], places[:, 0]) - self.angle_min_rad
        beam = np.round((bearing % (2 * np.pi)) / self.angle_increment_rad).astype(np.int64)
        inside: NDArray[np.bool_] = (beam >= 1) & (beam < len(self.ranges_m) - 1)
        beam = np.where(inside, beam, 1)
        shortest = np.minimum(
            np.minimum(self.ranges_m[beam - 1], self.ranges_m[beam]), self.ranges_m[beam + 1]
        )
        free: NDArray[np.bool_] = np.hypot(places[:, 0], places[:, 1]) < shortest - CLEARANCE_M
        return inside & free
