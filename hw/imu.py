"""The interface of inertial measurement units."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


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


class Imu(ABC):
    """A three-axis gyroscope and accelerometer."""

    @abstractmethod
    def read(self) -> ImuSample:
        """Return the newest sample."""
