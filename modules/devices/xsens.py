"""The robot's inertial measurement unit, if it is an Xsens MTi."""

import numpy as np

from hw.xsens.imu import BIT_RATE, OrientedSample, XsensImu
from modules.devices.imu import NO_ORIENTATION, axes
from modules.devices.pluggable import PluggableDeviceModule
from robbie_mp import Header, Time, setting
from robbie_mp.messages import Imu, Quaternion


class XsensModule(PluggableDeviceModule[OrientedSample]):
    """An MTi on a serial line or USB; publishes `Imu` on topic `imu`, and `DeviceState`."""

    bit_rate: int = setting(BIT_RATE, "bit/s of the unit's port", minimum=300)
    rate_hz: int = setting(100, "samples in each second; older units keep their own", minimum=1, maximum=400)

    def open_device(self) -> XsensImu:
        """Return the driver."""
        return XsensImu(self.url, self.rate_hz, self.bit_rate, clock=self.time_s, silence_s=self.silence_s)

    def on_value(self, value: OrientedSample) -> None:
        """Publish a sample."""
        sample, turned = value.sample, value.quaternion
        stamp = Time.from_nanoseconds(round(sample.stamp_s * 1e9))
        orientation = {} if turned is None else dict(zip("wxyz", turned.tolist(), strict=True))
        self.publish(
            Imu(
                header=Header(stamp=stamp, frame_id="imu"),
                orientation=Quaternion(**orientation),
                orientation_covariance=NO_ORIENTATION if turned is None else np.zeros(9),
                angular_velocity=axes(sample.turn_rad_per_s),
                linear_acceleration=axes(sample.acceleration_m_per_s2),
            ),
            topic="imu",
        )
