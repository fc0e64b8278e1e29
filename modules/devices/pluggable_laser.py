"""Base of the modules of laser range finders."""

import numpy as np

from robbie_mp import Header, Time, setting
from robbie_mp.messages import LaserScan
from robbie_robots.hw.laser import DeviceSweep
from robbie_robots.hw.pluggable_laser import PluggableLaser
from robbie_robots.modules.devices.pluggable import PluggableDeviceModule


class PluggableLaserModule(PluggableDeviceModule[DeviceSweep]):
    """A laser that may be pulled out and plugged in. A subclass opens its driver.

    Publishes `LaserScan`, stamped with the time of the sweep, and `DeviceState`, on a topic named after the
    module.
    """

    frame_id: str = setting("laser", "name of the laser's frame")

    def open_device(self) -> PluggableLaser:
        """Return the driver."""
        raise NotImplementedError

    @property
    def laser(self) -> PluggableLaser:
        """Return the driver."""
        assert isinstance(self.device, PluggableLaser)
        return self.device

    @property
    def complaint(self) -> str:
        """Return what the laser says is wrong with it."""
        return self.laser.complaint

    def on_value(self, value: DeviceSweep) -> None:
        """Publish a sweep."""
        geometry = self.laser.geometry
        self.publish(
            LaserScan(
                header=Header(
                    stamp=Time.from_nanoseconds(round(value.stamp_s * 1e9)), frame_id=self.frame_id
                ),
                angle_min=geometry.angle_min_rad,
                angle_max=geometry.angle_max_rad,
                angle_increment=geometry.angle_increment_rad,
                time_increment=self.laser.time_increment_s,
                scan_time=self.laser.period_s,
                range_min=geometry.range_min_m,
                range_max=geometry.range_max_m,
                ranges=value.ranges_m,
                intensities=np.zeros(0, np.float32) if value.intensities is None else value.intensities,
            )
        )
