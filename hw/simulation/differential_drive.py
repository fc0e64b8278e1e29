"""The geometry and limits of a robot with two driven wheels, and its wheel odometry."""

import math
from dataclasses import dataclass

from strenum import StrEnum

from robbie_robots.hw.pose import Pose


@dataclass(frozen=True)
class DifferentialDrive:
    """A robot's body, wheels and limits; the defaults are those of the stock robot.

    Attributes:
        body_radius_m: radius of the round body, whose centre is between the wheels.
        wheel_radius_m: radius of the wheels that the odometry assumes.
        axle_m: distance between the wheels that the odometry assumes.
        ticks_per_turn: encoder ticks per turn of a wheel.
        emergency_braking: ratio of deceleration to acceleration in an emergency and when a command expires.
    """

    body_radius_m: float = 0.20
    wheel_radius_m: float = 0.05
    axle_m: float = 0.32
    ticks_per_turn: int = 2048
    max_linear_m_per_s: float = 0.8
    max_angular_rad_per_s: float = 2.0
    max_wheel_m_per_s: float = 1.0
    max_linear_m_per_s2: float = 1.0
    max_angular_rad_per_s2: float = 5.0
    emergency_braking: float = 6.0

    @property
    def tick_m(self) -> float:
        """Return the distance that a wheel rolls per tick."""
        return 2 * math.pi * self.wheel_radius_m / self.ticks_per_turn

    def limited(self, linear_m_per_s: float, angular_rad_per_s: float) -> tuple[float, float]:
        """Return the speeds limited to the maximum.

        If a wheel would be too fast, both speeds are scaled down, which keeps the curvature.
        """
        linear = _clamp(linear_m_per_s, self.max_linear_m_per_s)
        angular = _clamp(angular_rad_per_s, self.max_angular_rad_per_s)
        fastest_wheel = abs(linear) + abs(angular) * self.axle_m / 2
        scale = min(1.0, self.max_wheel_m_per_s / fastest_wheel) if fastest_wheel > 0 else 1.0
        return linear * scale, angular * scale

    def braked(self, speeds: tuple[float, float], step_s: float) -> tuple[float, float]:
        """Return the (linear, angular) speeds one time step later in an emergency."""
        return self.approached(speeds, (0.0, 0.0), step_s * self.emergency_braking)

    def approached(
        self, speeds: tuple[float, float], wanted: tuple[float, float], step_s: float
    ) -> tuple[float, float]:
        """Return the (linear, angular) speeds one time step later, as the limits of acceleration allow."""
        linear_step = self.max_linear_m_per_s2 * step_s
        angular_step = self.max_angular_rad_per_s2 * step_s
        return (
            speeds[0] + _clamp(wanted[0] - speeds[0], linear_step),
            speeds[1] + _clamp(wanted[1] - speeds[1], angular_step),
        )

    def after_ticks(self, pose: Pose, left: int, right: int) -> Pose:
        """Return the odometry's pose after the wheels have turned by a number of ticks."""
        left_m, right_m = left * self.tick_m, right * self.tick_m
        return pose.after_arc((left_m + right_m) / 2, (right_m - left_m) / self.axle_m)


class RobotBody(StrEnum):
    """Bodies that a simulated base can have."""

    STOCK = "stock"
    CREATE = "create"

    @property
    def drive(self) -> DifferentialDrive:
        """Return the body's geometry and limits."""
        return CREATE_2 if self is RobotBody.CREATE else DifferentialDrive()


def _create_2() -> DifferentialDrive:
    """Return the body of an iRobot Create 2 (Open Interface Specification based on the Roomba 600)."""
    fastest, axle_m, wheel_radius_m, counts_per_turn = 0.5, 0.235, 0.036, 508.8
    return DifferentialDrive(
        body_radius_m=0.17,
        wheel_radius_m=wheel_radius_m,
        axle_m=axle_m,
        ticks_per_turn=round(counts_per_turn),
        max_linear_m_per_s=fastest,
        max_angular_rad_per_s=2 * fastest / axle_m,
        max_wheel_m_per_s=fastest,
    )


CREATE_2 = _create_2()


def _clamp(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
