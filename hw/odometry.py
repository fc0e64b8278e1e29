"""Wheel odometry with its uncertainty.

Source: S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics (2005), sections 5.4 (odometry) and 7.4
(linearization).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import ORIGIN


@dataclass(frozen=True)
class OdometryNoise:
    """How much wheels slip: variances that add up with the way.

    Attributes:
        distance: m^2 for each m driven.
        heading: rad^2 for each rad turned.
        heading_for_distance: rad^2 for each m driven.
    """

    distance: float = 0.0004
    heading: float = 0.002
    heading_for_distance: float = 0.0005


class Odometer:
    """Adds up what the wheels have done.

    Attributes:
        pose: since the start, in the odometry frame.
        covariance: (3, 3), of x, y and heading.
    """

    def __init__(self, noise: OdometryNoise | None = None) -> None:
        self._noise = noise or OdometryNoise()
        self.pose = ORIGIN
        self.covariance: NDArray[np.float64] = np.zeros((3, 3))

    def add(self, distance_m: float, turn_rad: float) -> None:
        """Add an arc of constant curvature."""
        direction = self.pose.heading_rad + turn_rad / 2
        cos, sin = math.cos(direction), math.sin(direction)
        by_pose = np.array([[1.0, 0.0, -distance_m * sin], [0.0, 1.0, distance_m * cos], [0.0, 0.0, 1.0]])
        by_arc = np.array([[cos, -distance_m * sin / 2], [sin, distance_m * cos / 2], [0.0, 1.0]])
        way_m, noise = abs(distance_m), self._noise
        turned = noise.heading * abs(turn_rad) + noise.heading_for_distance * way_m
        arc = np.diag([noise.distance * way_m, turned])
        self.covariance = by_pose @ self.covariance @ by_pose.T + by_arc @ arc @ by_arc.T
        self.pose = self.pose.after_arc(distance_m, turn_rad)
