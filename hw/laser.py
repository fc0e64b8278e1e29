"""The interface of planar laser range finders."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import ORIGIN, Pose


@dataclass(frozen=True)
class LaserGeometry:
    """A laser's mounting pose and beams. The default is one beam per degree over the full circle.

    Attributes:
        angle_min_rad: direction of the first beam in the laser's frame.
        angle_increment_rad: angle from beam to beam, counter-clockwise.
        beams: number of beams.
        range_min_m: minimum range.
        range_max_m: maximum range.
        mount: the laser's pose in the robot's frame.
    """

    angle_min_rad: float = -math.pi
    angle_increment_rad: float = math.pi / 180
    beams: int = 360
    range_min_m: float = 0.05
    range_max_m: float = 10.0
    mount: Pose = ORIGIN

    @property
    def angle_max_rad(self) -> float:
        """Return the direction of the last beam in the laser's frame."""
        return self.angle_min_rad + (self.beams - 1) * self.angle_increment_rad

    def angles_rad(self) -> NDArray[np.float64]:
        """Return the direction of each beam in the laser's frame: (beams,)."""
        return self.angle_min_rad + self.angle_increment_rad * np.arange(self.beams, dtype=np.float64)


@dataclass(frozen=True)
class DeviceSweep:
    """One sweep of a laser.

    Attributes:
        stamp_s: time of the sweep, on the device's clock.
        ranges_m: (beams,) float32; +inf for no return, -inf for an object nearer than `range_min_m`
            (REP 117).
        intensities: (beams,) float32, in the device's unit; None if it does not measure them.
    """

    stamp_s: float
    ranges_m: NDArray[np.float32]
    intensities: NDArray[np.float32] | None = None


class LaserRangeFinder(ABC):
    """A laser that measures ranges in one plane."""

    @property
    @abstractmethod
    def geometry(self) -> LaserGeometry:
        """Return the laser's mounting pose and beam directions."""

    @abstractmethod
    def scan(self) -> DeviceSweep:
        """Return the newest sweep."""
