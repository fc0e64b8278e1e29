"""Drives a course by the newest sweep alone: no map, no plan that outlives a sweep.

The driver tries arcs of many curvatures, as the dynamic window approach does (D. Fox, W. Burgard, S. Thrun,
1997). For each one it computes, in closed form, how far the robot can drive before it comes too near to
anything that the laser sees, and how fast it may be so that it can still stop before that. At the end of each
arc it looks on along a second one, so that it does not enter a way that soon ends.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RaceLimits:
    """The limits of the robot, and the distance that it keeps.

    Attributes:
        body_radius_m: radius of the round body.
        margin_m: distance to everything that the driver keeps besides, for noise and delay.
        max_linear_m_per_s: maximum speed ahead.
        max_angular_rad_per_s: maximum turn rate.
        max_wheel_m_per_s: maximum speed of a wheel.
        axle_m: distance between the wheels.
        braking_m_per_s2: deceleration that the driver counts on.
        reaction_s: time from a sweep to the effect of the command that follows from it.
    """

    body_radius_m: float = 0.20
    margin_m: float = 0.08
    max_linear_m_per_s: float = 0.8
    max_angular_rad_per_s: float = 2.0
    max_wheel_m_per_s: float = 1.0
    axle_m: float = 0.32
    braking_m_per_s2: float = 0.9
    reaction_s: float = 0.2

    def fastest(self, curvature_per_m: Array) -> Array:
        """Return the speed at which the robot can drive arcs, m/s: (N,)."""
        bend = np.abs(curvature_per_m)
        by_wheel = self.max_wheel_m_per_s / (1.0 + bend * self.axle_m / 2)
        by_turn = self.max_angular_rad_per_s / np.maximum(bend, 1e-9)
        fastest: Array = np.minimum(np.minimum(by_wheel, by_turn), self.max_linear_m_per_s)
        return fastest

    def stopping(self, free_m: Array) -> Array:
        """Return the speed from which the robot can stop within a distance, m/s: (N,)."""
        delay_m = self.braking_m_per_s2 * self.reaction_s
        speed: Array = np.sqrt(delay_m**2 + 2 * self.braking_m_per_s2 * np.maximum(free_m, 0.0)) - delay_m
        return speed


MAX_CURVATURE_PER_M = 3.0
ARCS = 41
SECOND_ARCS = 13
FIRST_PART_M = 0.6
"""Length of the first arc after which the driver looks on."""
HORIZON_M = 5.0
"""Beyond this, more free way is not worth more."""
STEADINESS_M = 0.25
"""Free way that the driver gives up rather than change its curvature by 1/m."""
ROOM_M = 0.35
"""Room beside the robot beyond which more is not worth more."""
ROOM_WORTH = 1.5
"""Free way that a metre of room beside the robot is worth."""
TURN_RAD_PER_S = 1.0
"""Turn rate on the spot when there is no way ahead."""


def free_ways(points: Array, curvatures: Array, radius_m: float, limit_m: float) -> Array:
    """Return how far a disc can drive along arcs before it touches a point, m: (..., N), at most `limit_m`.

    Args:
        points: (..., M, 2), m, in the frame of the disc: x ahead, y to the left.
        curvatures: (N,), 1/m, positive to the left; 0 is a straight way.
        radius_m: radius of the disc. A point within it leaves no way towards it.
        limit_m: length of the arcs; less than a full circle counts.
    """
    bends = np.where(np.abs(curvatures) < 1e-3, 1e-3, curvatures)[:, None]
    turn_radius = 1.0 / bends
    x, y = points[..., None, :, 0], points[..., None, :, 1]
    size = np.abs(turn_radius)
    inward = np.where(turn_radius > 0, size - y, size + y)  # towards the centre of the turn
    squared = x**2 + inward**2
    from_centre = np.sqrt(squared)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (size**2 - radius_m**2 + squared) / (2 * size * from_centre)
    # The angle of the turn at which the disc touches the point first.
    bearing = np.arctan2(x, inward)
    first = np.mod(bearing - np.arccos(np.clip(cosine, -1.0, 1.0)), 2 * math.pi)
    # A disc that overlaps a point already may only drive away from it.
    overlaps = x**2 + y**2 < radius_m**2
    first = np.where(overlaps, np.where(bearing > 0, 0.0, 2 * math.pi), first)
    way = np.where(np.abs(cosine) <= 1.0, first * size, np.inf)
    nearest: Array = np.minimum(way.min(axis=-1, initial=np.inf), limit_m)
    return nearest


def moved(points: Array, curvatures: Array, distances_m: Array) -> Array:
    """Return points as they are seen after driving arcs: (N, M, 2), m.

    Args:
        points: (M, 2), m.
        curvatures: (N,), 1/m.
        distances_m: (N,): lengths of the arcs.
    """
    turn = curvatures * distances_m
    half = turn / 2
    chord = distances_m * np.sinc(half / math.pi)
    dx = points[:, 0] - (chord * np.cos(half))[:, None]
    dy = points[:, 1] - (chord * np.sin(half))[:, None]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    return np.stack((cos * dx + sin * dy, -sin * dx + cos * dy), axis=-1)


class RaceDriver:
    """Chooses speeds from sweeps of a laser in the middle of the robot.

    Args:
        limits: what the robot can do.
    """

    def __init__(self, limits: RaceLimits | None = None) -> None:
        self.limits = limits or RaceLimits()
        self._curvatures = np.linspace(-MAX_CURVATURE_PER_M, MAX_CURVATURE_PER_M, ARCS)
        self._second = np.linspace(-1.5, 1.5, SECOND_ARCS)
        self._chosen = 0.0

    def drive(self, sweep: LaserSweep, speed_m_per_s: float) -> tuple[float, float]:
        """Return the speeds to drive now, m/s and rad/s.

        Args:
            sweep: the newest sweep, which must be usable.
            speed_m_per_s: present speed.
        """
        points = self._points(sweep)
        radius_m = self.limits.body_radius_m + self.limits.margin_m
        free = free_ways(points, self._curvatures, radius_m, HORIZON_M)
        if free.max() < 0.05:
            return 0.0, TURN_RAD_PER_S * (1.0 if self._chosen >= 0 else -1.0)
        worth = self._worth(points, free, radius_m)
        worth -= STEADINESS_M * np.abs(self._curvatures - self._chosen)
        best = int(worth.argmax())
        self._chosen = float(self._curvatures[best])
        wanted = min(
            float(self.limits.fastest(self._curvatures[best : best + 1])[0]),
            float(self.limits.stopping(free[best : best + 1])[0]),
        )
        # A faster robot than it should be brakes on its arc; the turn rate follows the speed that it has.
        return wanted, self._chosen * max(wanted, min(speed_m_per_s, wanted + 0.1))

    def _points(self, sweep: LaserSweep) -> Array:
        """Return what the sweep hit: (M, 2), m. What is too near to measure touches the body."""
        touching = sweep.directions[np.isneginf(sweep.ranges_m)] * self.limits.body_radius_m
        return np.concatenate([sweep.points(HORIZON_M + FIRST_PART_M), touching])

    def _worth(self, points: Array, free: Array, radius_m: float) -> Array:
        """Return how good each arc is, in m of free way, with what follows it and the room beside it."""
        worth = np.full(len(free), -np.inf)
        tried = np.flatnonzero(free >= min(FIRST_PART_M, free.max()))
        first_m = np.minimum(FIRST_PART_M, free[tried])
        then = moved(points, self._curvatures[tried], first_m)
        on_m = free_ways(then, self._second, radius_m, HORIZON_M).max(axis=-1)
        room_m = np.hypot(then[..., 0], then[..., 1]).min(axis=-1, initial=np.inf) - radius_m
        worth[tried] = np.minimum(first_m + on_m, HORIZON_M) + ROOM_WORTH * np.clip(room_m, 0.0, ROOM_M)
        return worth
