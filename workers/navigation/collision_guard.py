"""The last check before a command goes to the drive: whether the newest sweep leaves room to stop.

After the admissible velocities of Fox, Burgard and Thrun, "The dynamic window approach to collision
avoidance" (IEEE RAM, 1997): a speed is allowed if the robot can stop before it touches anything on its arc.
What may move, such as another robot, may come nearer meanwhile: the robot uses half of the way to it at most,
and keeps more distance.
"""

import math
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.navigation.path_follower import Velocity
from workers.planar_pose import rotate

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
    """Slows and stops the robot before it touches anything the laser sees, or several lasers see.

    Args:
        angles_rad: `(N,)`, directions of the laser's beams in the laser's frame.
        mount: The laser's mounting pose (x, y, heading) in the robot's frame, m and rad.
        settings: The robot's body and brakes.
    """

    def __init__(
        self, angles_rad: ArrayLike, mount: ArrayLike = (0.0, 0.0, 0.0), settings: GuardSettings | None = None
    ) -> None:
        angles = np.asarray(angles_rad, float)
        pose = np.asarray(mount, float)
        self._settings = settings or GuardSettings()
        # Of each beam, in the robot's frame: where it begins, and its direction.
        self._beams = rotate(float(pose[2]), np.column_stack([np.cos(angles), np.sin(angles)]))
        self._origins = np.broadcast_to(pose[:2], self._beams.shape)
        self._touching_m = self._to_the_bodys_edge_m()
        reach_m = self._settings.look_m + self._settings.body_radius_m + self._settings.margin_m
        self._reach_m = np.full(len(angles), reach_m + float(np.hypot(*pose[:2])))

    def joined(self, other: "CollisionGuard") -> "CollisionGuard":
        """Return a guard for the beams of both, first this one's; it has the settings of this one."""
        both = copy(self)
        both._beams = np.concatenate([self._beams, other._beams])
        both._origins = np.concatenate([self._origins, other._origins])
        both._touching_m = np.concatenate([self._touching_m, other._touching_m])
        both._reach_m = np.concatenate([self._reach_m, other._reach_m])
        return both

    def _to_the_bodys_edge_m(self) -> NDArray[np.float64]:
        """Return how long each beam is inside the body: `(N,)`; 0 if the laser stands beside the body."""
        along = (self._origins * self._beams).sum(axis=1)
        inside = self._settings.body_radius_m**2 - (self._origins**2).sum(axis=1)
        return np.where(inside > 0.0, np.sqrt(along**2 + np.maximum(inside, 0.0)) - along, 0.0)

    def near_points(self, ranges_m: ArrayLike) -> NDArray[np.float64]:
        """Return what the sweep hit near enough to count: `(K, 2)`, m, robot frame.

        Args:
            ranges_m: `(N,)`; +inf or NaN: no return; -inf: an obstacle too near to measure (REP 117).
        """
        # An obstacle too near to measure counts as touching the body, so that the robot can still drive away.
        measured = np.asarray(ranges_m, float)
        ranges = np.where(np.isneginf(measured), self._touching_m, measured)
        near = ranges <= self._reach_m
        return self._origins[near] + ranges[near, None] * self._beams[near]

    def checked(self, ranges_m: ArrayLike, wanted: Velocity, loose: Loose = None) -> Velocity:
        """Return the wanted speeds, reduced as the sweep requires: on the same arc, or turning on the spot.

        Args:
            ranges_m: `(N,)`; +inf or NaN: no return; -inf: an obstacle too near to measure (REP 117).
            wanted: Forward speed and turn rate.
            loose: `(K,)`, which of the `near_points` may move. None: none.
        """
        linear, angular = wanted
        if linear == 0.0:
            return wanted
        points = self.near_points(ranges_m)
        way_m = self._free_way_m(points, linear, angular, loose)
        allowed = min(self._admissible(way_m), self._near_limit(points, loose))
        if allowed < self._settings.min_linear_m_per_s:
            return 0.0, angular
        scale = min(1.0, allowed / abs(linear))
        return linear * scale, angular * scale

    def free_way_m(
        self,
        ranges_m: ArrayLike,
        linear_m_per_s: float,
        angular_rad_per_s: float,
        loose: Loose = None,
    ) -> float:
        """Return how far the robot can drive on an arc until something is nearer than the margin.

        If an obstacle is nearer than the margin already, arcs that lead away from it are free.
        """
        return self._free_way_m(self.near_points(ranges_m), linear_m_per_s, angular_rad_per_s, loose)

    def _free_way_m(
        self,
        points: NDArray[np.float64],
        linear_m_per_s: float,
        angular_rad_per_s: float,
        loose: Loose,
    ) -> float:
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
