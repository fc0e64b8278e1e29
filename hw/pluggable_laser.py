"""Base of the drivers of laser range finders."""

import math

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Unpack

from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.errors import DeviceSilent
from robbie_robots.hw.laser import DeviceSweep, LaserGeometry, LaserRangeFinder


class PluggableLaser(PluggableDevice[DeviceSweep], LaserRangeFinder):
    """A laser that connects by itself; `poll` returns its sweeps. Its geometry is known once reported.

    Args:
        url: the port: see `Port`.
        bit_rate: bit/s at the start, on a serial line.
        options: see `DeviceOptions`.

    Attributes:
        period_s: time between sweeps; 0 before it is known.
        time_increment_s: time between two beams; 0 if the laser does not tell.
        complaint: what the laser says is wrong with it, such as dirt before it; '' if nothing.
    """

    def __init__(
        self,
        url: str,
        bit_rate: int = 115_200,
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, bit_rate, **options)
        self.period_s = self.time_increment_s = 0.0
        self.complaint = ""
        self._geometry: LaserGeometry | None = None

    @property
    def geometry(self) -> LaserGeometry:
        """Return the laser's beams, as it told them last.

        Raises:
            DeviceSilent: the laser has not been connected yet.
        """
        if self._geometry is None:
            raise DeviceSilent(f"the laser at {self.url} has not told its geometry yet: {self.reason}")
        return self._geometry

    def scan(self) -> DeviceSweep:
        """Wait for a sweep and return it, or the newest of several.

        Raises:
            DeviceSilent: no sweep arrived in time.
        """
        end_s = self._monotonic() + self.silence_s
        while (left_s := end_s - self._monotonic()) > 0:
            if sweeps := self.poll(left_s):
                return sweeps[-1]
        raise DeviceSilent(
            f"the laser at {self.url} has sent no sweep for {self.silence_s:g} s: {self.reason}"
        )


def ranges_in_metres(
    values: NDArray[np.int64] | NDArray[np.float64], unit_m: float, geometry: LaserGeometry
) -> NDArray[np.float32]:
    """Return ranges: (N,) float32. What lies outside the laser's limits is +inf.

    That includes the codes that lasers send in place of a short range: they do not tell what is the case.
    """
    ranges: NDArray[np.float32] = (values * unit_m).astype(np.float32)
    least, most = np.float32(geometry.range_min_m), np.float32(geometry.range_max_m)
    ranges[~((ranges >= least) & (ranges <= most))] = math.inf
    return ranges
