"""The robot's inertial measurement unit, if it is an Xsens MTi."""

from robbie_mp import setting
from robbie_robots.hw.xsens.imu import BIT_RATE, XsensImu
from robbie_robots.modules.devices.pluggable_imu import PluggableImuModule


class XsensModule(PluggableImuModule):
    """An MTi on a serial line or USB; publishes `Imu` on topic `imu`, and `DeviceState`."""

    bit_rate: int = setting(BIT_RATE, "bit/s of the unit's port", minimum=300)
    rate_hz: int = setting(100, "samples in each second; older units keep their own", minimum=1, maximum=400)

    def open_device(self) -> XsensImu:
        """Return the driver."""
        return XsensImu(self.url, self.rate_hz, self.bit_rate, clock=self.time_s, silence_s=self.silence_s)
