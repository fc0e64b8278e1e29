"""What the modules of inertial measurement units share."""

import numpy as np

from robbie_mp import Header, Time
from robbie_mp.messages import Imu, Quaternion
from robbie_robots.hw.imu import OrientedSample
from robbie_robots.modules.devices.imu import NO_ORIENTATION, axes
from robbie_robots.modules.devices.pluggable import PluggableDeviceModule


class PluggableImuModule(PluggableDeviceModule[OrientedSample]):
    """An inertial measurement unit that may be pulled out and plugged in. A subclass opens its driver.

    Publishes `Imu` on topic `imu`, and `DeviceState` on a topic named after the module.
    """

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
