"""The interface of inertial measurement units."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GATHER_S = 0.01
"""Each read has a price of its own. It is the greater part of what a unit of 500 Hz costs."""


@dataclass(frozen=True)
class ImuSample:
    """The unit's measurements since the previous sample, in its own frame (REP 103: x ahead, y left, z up).

    Attributes:
        stamp_s: end of that interval, on the device's clock.
        turn_rad_per_s: (3,), mean rates of turn.
        acceleration_m_per_s2: (3,), mean specific force: a unit at rest measures +9.81 along z.
    """

    stamp_s: float
    turn_rad_per_s: NDArray[np.float64]
    acceleration_m_per_s2: NDArray[np.float64]


@dataclass(frozen=True)
class OrientedSample:
    """A sample, with the orientation that the unit has computed from it.

    Attributes:
        sample: turn rates and acceleration.
        quaternion: w, x, y, z, from the unit's frame to the world's (z up); None: not told.
    """

    sample: ImuSample
    quaternion: NDArray[np.float64] | None


def gathered_s(rate_hz: float) -> float:
    """Return how long a driver lets samples gather before it reads them, at the rate of its unit.

    Whole periods of the unit: so the newest sample has just arrived, and its stamp is right.
    """
    periods = math.floor(GATHER_S * rate_hz + 1e-9)
    return periods / rate_hz if periods > 1 else 0.0


class Imu(ABC):
    """A three-axis gyroscope and accelerometer."""

    @abstractmethod
    def read(self) -> ImuSample:
        """Return the newest sample."""
