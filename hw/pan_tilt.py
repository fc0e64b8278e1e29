"""The interface of pan-tilt units."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass


class PanTiltError(ValueError):
    """An invalid direction: an angle is NaN or infinite."""


@dataclass(frozen=True)
class PanTiltLimits:
    """A unit's limits.

    Attributes:
        pan_rad: maximum pan to each side.
        tilt_up_rad: maximum tilt above the horizon.
        tilt_down_rad: maximum tilt below the horizon.
        rate_rad_per_s: speed of each joint.
    """

    pan_rad: float = 2.6
    tilt_up_rad: float = 0.8
    tilt_down_rad: float = 0.8
    rate_rad_per_s: float = 2.0

    def within(self, pan_rad: float, tilt_rad: float) -> tuple[float, float]:
        """Return the nearest direction within the limits.

        Raises:
            PanTiltError: an angle is NaN or infinite.
        """
        for name, angle in (("pan_rad", pan_rad), ("tilt_rad", tilt_rad)):
            if not math.isfinite(angle):
                raise PanTiltError(f"{name} of a direction must be a finite number, not {angle}")
        pan = max(-self.pan_rad, min(self.pan_rad, pan_rad))
        return pan, max(-self.tilt_up_rad, min(self.tilt_down_rad, tilt_rad))


@dataclass(frozen=True)
class PanTiltState:
    """A unit's direction at one time.

    Angles are right-handed: pan is positive to the left, tilt is positive below the horizon.
    """

    stamp_s: float
    pan_rad: float
    tilt_rad: float
    pan_rad_per_s: float
    tilt_rad_per_s: float


class PanTiltUnit(ABC):
    """Turns a device: first about the vertical axis, then about the axis to the left."""

    @abstractmethod
    def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Move towards a direction; beyond the limits, to the nearest one within.

        Raises:
            PanTiltError: an angle is NaN or infinite.
        """

    @abstractmethod
    def read(self) -> PanTiltState:
        """Return the unit's current direction."""
