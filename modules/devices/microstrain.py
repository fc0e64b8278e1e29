"""The robot's inertial measurement unit, if it is a MicroStrain with MIP."""

from robbie_mp import setting
from robbie_robots.hw.microstrain.imu import BIT_RATE, MicroStrainImu
from robbie_robots.modules.devices.pluggable_imu import PluggableImuModule


class MicroStrainModule(PluggableImuModule):
    """A MicroStrain unit on a serial line or USB; publishes `Imu` on topic `imu`, and `DeviceState`."""

    bit_rate: int = setting(BIT_RATE, "bit/s of the unit's port", minimum=300)
    rate_hz: int = setting(
        100, "samples in each second; the unit takes the nearest rate that it has", minimum=1, maximum=1000
    )

    def open_device(self) -> MicroStrainImu:
        """Return the driver."""
        return MicroStrainImu(
            self.url, self.rate_hz, self.bit_rate, clock=self.time_s, silence_s=self.silence_s
        )
