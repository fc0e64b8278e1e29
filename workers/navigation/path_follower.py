"""Follows a path with a differential drive.

Pure pursuit: drive the arc that leads through a point of the path some way ahead (Coulter, "Implementation
of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01, 1992); turn on the spot when the point lies
too far aside.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.planar_pose import relative

Velocity = tuple[float, float]
"""Forward speed (m/s) and turn rate (rad/s, positive to the left)."""

HALT: Velocity = (0.0, 0.0)


@dataclass(frozen=True)
class FollowerSettings:
    """Settings of the path follower.

    Attributes:
        max_linear_m_per_s: Maximum forward speed.
        max_angular_rad_per_s: Maximum turn rate.
        deceleration_m_per_s2: Deceleration at the path's end.
        lookahead_m: Distance along the path to the point that the robot steers for.
        turn_above_rad: Turn on the spot when the point lies farther aside than this ...
        drive_below_rad: ... until it lies nearer than this.
        turn_gain_per_s: Turn rate on the spot per remaining angle.
        arrived_m: Distance at which the path's end counts as reached.
    """

    max_linear_m_per_s: float = 0.5
    max_angular_rad_per_s: float = 1.8
    deceleration_m_per_s2: float = 0.6
    lookahead_m: float = 0.35
    turn_above_rad: float = 1.0
    drive_below_rad: float = 0.4
    turn_gain_per_s: float = 2.5
    arrived_m: float = 0.12


class PathFollower:
    """Steers along the newest path; path and settings may change at any time."""

    def __init__(self, settings: FollowerSettings | None = None) -> None:
        self.settings = settings or FollowerSettings()
        self._path: NDArray[np.float64] = np.empty((0, 2))
        self._turning = False

    @property
    def path(self) -> NDArray[np.float64]:
        """Return the path followed: `(N, 2)`, m, map frame; empty if none."""
        return self._path

    @property
    def is_turning(self) -> bool:
        """Return whether the robot turns on the spot."""
        return self._turning

    def follow(self, path: ArrayLike) -> None:
        """Follow a path `(N, 2)`, m, map frame, from now on. An empty path stops the robot."""
        self._path = np.asarray(path, float).reshape(-1, 2)

    def is_arrived(self, pose: ArrayLike) -> bool:
        """Return whether the path's end is reached; False without a path."""
        if len(self._path) == 0:
            return False
        return float(np.hypot(*(self._path[-1] - np.asarray(pose, float)[:2]))) <= self.settings.arrived_m

    def way_left_m(self, pose: ArrayLike) -> float:
        """Return the remaining length of the path; 0 without a path."""
        return self._target(np.asarray(pose, float)[:2])[1] if len(self._path) else 0.0

    def target_xy_m(self, pose: ArrayLike) -> NDArray[np.float64]:
        """Return the point of the path, m, map frame, that the robot steers for. There must be a path."""
        return self._target(np.asarray(pose, float)[:2])[0]

    def velocity(self, pose: ArrayLike) -> Velocity:
        """Return the speeds that lead along the path.

        Args:
            pose: The robot's (x, y, heading), m and rad, map frame.
        """
        if len(self._path) == 0 or self.is_arrived(pose):
            self._turning = False
            return HALT
        target, way_m = self._target(np.asarray(pose, float)[:2])
        ahead, left, _ = relative(pose, [*target, 0.0])
        aside_rad = math.atan2(left, ahead)
        limit = self.settings.drive_below_rad if self._turning else self.settings.turn_above_rad
        self._turning = abs(aside_rad) > limit
        if self._turning:
            return 0.0, self._within(self.settings.turn_gain_per_s * aside_rad)
        return self._arc(aside_rad, math.hypot(ahead, left), way_m)

    def _arc(self, aside_rad: float, distance_m: float, way_m: float) -> Velocity:
        """Return speeds on the arc through the target, slower in curves and towards the end."""
        settings = self.settings
        curvature = 2 * math.sin(aside_rad) / max(distance_m, 0.05)
        linear = min(
            settings.max_linear_m_per_s * math.cos(aside_rad),
            math.sqrt(2 * settings.deceleration_m_per_s2 * way_m),
            settings.max_angular_rad_per_s / max(abs(curvature), 1e-6),
        )
        return linear, self._within(linear * curvature)

    def _target(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Return the point to steer for, and the remaining length of the path, m."""
        distances = np.hypot(*(self._path - position).T)
        nearest = int(np.argmin(distances))
        ahead = self._path[nearest:]
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ahead, axis=0).T))])
        index = min(int(np.searchsorted(along, self.settings.lookahead_m)), len(ahead) - 1)
        return ahead[index], float(along[-1] + distances[nearest])

    def _within(self, angular: float) -> float:
        limit = self.settings.max_angular_rad_per_s
        return max(-limit, min(limit, angular))
