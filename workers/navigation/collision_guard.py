"""The last check before a command goes to the drive: whether the newest sweep leaves room to stop.

After the admissible velocities of Fox, Burgard and Thrun, "The dynamic window approach to collision
avoidance" (IEEE RAM, 1997): a speed is allowed if the robot can stop before it touches anything on its arc.
What may move, such as another robot, may come nearer meanwhile: the robot uses half of the way to it at most,
and keeps more distance.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import MountedSweep
from robbie_robots.workers.navigation.path_follower import Velocity
from robbie_robots.workers.planar_pose import rotate

ARC_STEP_M = 0.03
Loose = NDArray[np.bool_] | None


@dataclass(frozen=True)
class GuardSettings:
    """The robot's body and brakes.

    Attributes:
        body_radius_m: The body is round; turning on the spot touches nothing.
        margin_m: Kept free around the body.
        loose_margin_m: Kept free around the body in addition, towards what may move.
        deceleration_m_per_s2: Guaranteed deceleration.
        reaction_s: Age of a sweep plus the drive's reaction time.
        look_m: Checked distance along the arc.
        min_linear_m_per_s: The robot stops instead of driving slower than this.
        crawl_m_per_s: Maximum speed when the robot almost touches an obstacle in any direction.
        speed_per_room_per_s: Increase of this maximum per metre of free space.
    """

    body_radius_m: float = 0.20
    margin_m: float = 0.05
    loose_margin_m: float = 0.1
    deceleration_m_per_s2: float = 0.8
    reaction_s: float = 0.2
    look_m: float = 0.8
    min_linear_m_per_s: float = 0.03
    crawl_m_per_s: float = 0.1
    speed_per_room_per_s: float = 2.0


class CollisionGuard:
    """Slows and stops the robot before it touches anything that one or more lasers see.

    `near_points` takes the newest sweeps, each with its own geometry; the other methods take those points.
    The body is round, so the robot may always turn on the spot. A robot without a usable sweep has no points
    either: the driver must stop it first.

    Args:
        settings: The robot's body and brakes.
    """

    def __init__(self, settings: GuardSettings | None = None) -> None:
        self._settings = settings or GuardSettings()

    def near_points(self, sweeps: Iterable[MountedSweep]) -> NDArray[np.float64]:
        """Return what the sweeps hit near enough to count: `(K, 2)`, m, robot frame."""
        return np.concatenate([np.empty((0, 2)), *(self._near(one) for one in sweeps)])

    def _near(self, seen: MountedSweep) -> NDArray[np.float64]:
        mount = np.asarray(seen.mount, float)
        reach_m = self._settings.look_m + self._settings.body_radius_m + self._settings.margin_m
        near = seen.sweep.ranges_m <= reach_m + float(np.hypot(*mount[:2]))
        ranges, beams = seen.sweep.ranges_m[near], rotate(float(mount[2]), seen.sweep.directions[near])
        # An obstacle too near to measure counts as touching the body, so that the robot can still drive away.
        ranges = np.where(np.isneginf(ranges), self._to_the_bodys_edge_m(mount[:2], beams), ranges)
        return mount[:2] + ranges[:, None] * beams

    def _to_the_bodys_edge_m(
        self, origin: NDArray[np.float64], beams: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how long each beam is inside the body: `(N,)`; 0 if the laser stands beside the body."""
        inside = self._settings.body_radius_m**2 - float(origin @ origin)
        if inside <= 0.0:
            return np.zeros(len(beams))
        along = beams @ origin
        return np.asarray(np.sqrt(along**2 + inside) - along)

    def checked(self, points: NDArray[np.float64], wanted: Velocity, loose: Loose = None) -> Velocity:
        """Return the wanted speeds, reduced as the sweeps require: on the same arc, or turning on the spot.

        Args:
            points: `(K, 2)`, the `near_points` of the newest sweeps.
            wanted: Forward speed, negative backwards, and turn rate.
            loose: `(K,)`, which of the points may move. None: none.
        """
        linear, angular = wanted
        if linear == 0.0:
            return wanted
        way_m = self.free_way_m(points, linear, angular, loose)
        allowed = min(self._admissible(way_m), self._near_limit(points, loose))
        if allowed < self._settings.min_linear_m_per_s:
            return 0.0, angular
        scale = min(1.0, allowed / abs(linear))
        return linear * scale, angular * scale

    def free_way_m(
        self,
        points: NDArray[np.float64],
        linear_m_per_s: float,
        angular_rad_per_s: float,
        loose: Loose = None,
    ) -> float:
        """Return how far the robot can drive on an arc until something is nearer than the margin.

        If an obstacle is nearer than the margin already, arcs that lead away from it are free.
        """
        if loose is None or not loose.any():
            return self._way_to_m(points, linear_m_per_s, angular_rad_per_s, self._settings.margin_m)
        margin_m = self._settings.margin_m + self._settings.loose_margin_m
        return min(
            self._way_to_m(points[~loose], linear_m_per_s, angular_rad_per_s, self._settings.margin_m),
            self._way_to_m(points[loose], linear_m_per_s, angular_rad_per_s, margin_m) / 2,
        )

    def _way_to_m(
        self,
        points: NDArray[np.float64],
        linear_m_per_s: float,
        angular_rad_per_s: float,
        margin_m: float,
    ) -> float:
        settings = self._settings
        if len(points) == 0:
            return settings.look_m
        ways = np.arange(0.0, settings.look_m + ARC_STEP_M, ARC_STEP_M)
        centres = _arc_points(ways * math.copysign(1.0, linear_m_per_s), angular_rad_per_s / linear_m_per_s)
        room = np.sqrt(((points - centres[:, None]) ** 2).sum(axis=2)).min(axis=1)
        room -= settings.body_radius_m + margin_m
        blocked = (room < 0.0) & (room <= room[0] + 0.2 * ways)
        blocked[0] = False
        if not blocked.any():
            return settings.look_m
        return float(ways[np.argmax(blocked) - 1])

    def _near_limit(self, points: NDArray[np.float64], loose: Loose) -> float:
        """Return the maximum speed that the distance to the nearest obstacle allows, in any direction."""
        away_m = np.hypot(*points.T) - self._settings.body_radius_m
        if loose is not None:
            away_m = np.where(loose, (away_m - self._settings.loose_margin_m) / 2, away_m)
        room_m = max(0.0, float(away_m.min(initial=np.inf)))
        return self._settings.crawl_m_per_s + self._settings.speed_per_room_per_s * room_m

    def _admissible(self, free_way_m: float) -> float:
        """Return the maximum speed from which the robot can stop within the distance."""
        braking, reaction_s = self._settings.deceleration_m_per_s2, self._settings.reaction_s
        return math.sqrt((braking * reaction_s) ** 2 + 2 * braking * free_way_m) - braking * reaction_s


def _arc_points(ways_m: NDArray[np.float64], curvature: float) -> NDArray[np.float64]:
    """Return where the robot's centre is `(K, 2)`, m, after each way on an arc from the origin along x."""
    if abs(curvature) < 1e-6:
        return np.column_stack([ways_m, np.zeros_like(ways_m)])
    turns = ways_m * curvature
    return np.column_stack([np.sin(turns), 1 - np.cos(turns)]) / curvature
