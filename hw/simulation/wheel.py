"""A simulated wheel with an inexact encoder."""

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class WheelErrors:
    """The errors of wheel odometry. With the defaults, it drifts by some degrees and decimetres in a minute.

    Attributes:
        left_scale: the left wheel's count is too high by this fraction (the tyre is smaller than assumed).
        right_scale: the same for the right wheel.
        slip_m_per_sqrt_m: standard deviation of a wheel's slip after one metre. Slip is a random walk, so it
            grows with the square root of the distance.
    """

    left_scale: float = 0.002
    right_scale: float = -0.0015
    slip_m_per_sqrt_m: float = 0.003


class SimulatedWheel:
    """Converts the true distance that one wheel rolls into encoder ticks."""

    def __init__(
        self, tick_m: float, scale_error: float, slip_m_per_sqrt_m: float, seed: tuple[int, int]
    ) -> None:
        self._tick_m = tick_m
        self._scale = 1.0 + scale_error
        self._slip = slip_m_per_sqrt_m
        self._random = np.random.default_rng(seed)
        self._rest_m = 0.0

    def roll(self, way_m: float) -> int:
        """Return the ticks that the encoder counts while the wheel rolls a distance."""
        if way_m == 0.0:
            return 0
        slip_m = self._slip * math.sqrt(abs(way_m)) * self._random.standard_normal()
        self._rest_m += way_m * self._scale + slip_m
        ticks = math.floor(self._rest_m / self._tick_m)
        self._rest_m -= ticks * self._tick_m
        return ticks
