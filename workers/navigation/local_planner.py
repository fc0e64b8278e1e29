"""Local control: along the path and around obstacles.

The dynamic window approach (Fox, Burgard and Thrun, IEEE RAM 1997), in the space of arcs: of the free
arcs, it takes the one with the best end. While the path itself is free, the robot follows it by pure pursuit
alone.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.navigation.collision_guard import CollisionGuard, Loose
from robbie_robots.workers.navigation.path_follower import HALT, PathFollower, Velocity
from robbie_robots.workers.planar_pose import relative


@dataclass(frozen=True)
class LocalSettings:
    """Settings of the local planner.

    Attributes:
        free_share: The path counts as free if the guard allows this share of the wanted speed.
        curvatures_per_m: Maximum curvature tried.
        arcs: Number of arcs tried, on both sides together.
        step_m: Arcs are judged by their end after this distance.
        least_way_m: Arcs with a shorter free distance are not driven.
        heading_weight_m: Cost of 1 rad between heading and target.
        change_weight_m: Cost of changing the curvature by the maximum curvature.
        max_linear_m_per_s: Maximum forward speed around obstacles.
        max_angular_rad_per_s: Maximum turn rate.
    """

    free_share: float = 0.3
    curvatures_per_m: float = 3.0
    arcs: int = 21
    step_m: float = 0.5
    least_way_m: float = 0.15
    heading_weight_m: float = 0.15
    change_weight_m: float = 0.1
    max_linear_m_per_s: float = 0.3
    max_angular_rad_per_s: float = 1.5


class LocalPlanner:
    """Chooses the next speeds.

    Args:
        guard: Checks every command against the newest sweeps.
        follower: Steers along the path.
        settings: Settings of the local planner.

    Attributes:
        avoiding: Whether the last speeds led around an obstacle.
    """

    def __init__(
        self, guard: CollisionGuard, follower: PathFollower, settings: LocalSettings | None = None
    ) -> None:
        self.avoiding = False
        self.guard, self.follower = guard, follower
        self._settings = settings or LocalSettings()
        self._curvature = 0.0

    def velocity(self, pose: ArrayLike, points: NDArray[np.float64], loose: Loose = None) -> Velocity:
        """Return the speeds for the drive; HALT if every arc is blocked.

        Args:
            pose: The robot's (x, y, heading), m and rad, map frame.
            points: `(K, 2)`, the guard's `near_points` of the newest sweeps.
            loose: `(K,)`, which of them may move. None: none.
        """
        wanted = self.follower.velocity(pose)
        allowed = self.guard.checked(points, wanted, loose)
        self.avoiding = wanted[0] > 0.0 and allowed[0] < self._settings.free_share * wanted[0]
        if not self.avoiding:
            self._curvature = wanted[1] / wanted[0] if wanted[0] > 0.0 else 0.0
            return allowed
        arc = self._best_arc(relative(pose, [*self.follower.target_xy_m(pose), 0.0])[:2], points, loose)
        return HALT if arc is None else self.guard.checked(points, arc, loose)

    def _best_arc(
        self, target: NDArray[np.float64], points: NDArray[np.float64], loose: Loose
    ) -> Velocity | None:
        """Return speeds on the best free arc to a target `(2,)`, m, robot's frame; None if there is none."""
        settings = self._settings
        best, best_cost = None, math.inf
        for curvature in np.linspace(-settings.curvatures_per_m, settings.curvatures_per_m, settings.arcs):
            linear = min(
                settings.max_linear_m_per_s, settings.max_angular_rad_per_s / max(abs(curvature), 1e-6)
            )
            way_m = self.guard.free_way_m(points, linear, linear * curvature, loose)
            if way_m < settings.least_way_m:
                continue
            cost = self._cost_m(float(curvature), min(way_m, settings.step_m), target)
            if cost < best_cost:
                best, best_cost = (linear, linear * float(curvature)), cost
        self._curvature = 0.0 if best is None else best[1] / best[0]
        return best

    def _cost_m(self, curvature: float, way_m: float, target: NDArray[np.float64]) -> float:
        """Return an arc's cost, from position and heading at its end."""
        settings, turn = self._settings, curvature * way_m
        chord = way_m * (math.sin(turn / 2) / (turn / 2) if abs(turn) > 1e-6 else 1.0)
        dx, dy = target - chord * np.array([math.cos(turn / 2), math.sin(turn / 2)])
        aside = abs(math.remainder(math.atan2(dy, dx) - turn, math.tau))
        change = abs(curvature - self._curvature) / settings.curvatures_per_m
        cost = math.hypot(dx, dy) + settings.heading_weight_m * aside + settings.change_weight_m * change
        return cost
