"""The robot's pan-tilt unit, if it is a PTU of FLIR or Directed Perception."""

import numpy as np

from robbie_mp import Header, Time, setting
from robbie_mp.messages import JointState
from robbie_robots.hw.flir.ptu import BIT_RATE, FlirPanTilt
from robbie_robots.hw.pan_tilt import PanTiltState
from robbie_robots.modules.devices.command_age import LOOK_AGE_S
from robbie_robots.modules.devices.pan_tilt import JOINTS, TOPIC, PanTiltByHand
from robbie_robots.modules.devices.pluggable import PluggableDeviceModule


class FlirPanTiltModule(PluggableDeviceModule[PanTiltState]):
    """A PTU on a serial line: follows `PanTiltCommand`, publishes `JointState` on topic `pan_tilt`.

    The joints are `pan` and `tilt`, and can also be moved by hand: see `PanTiltByHand`. Also publishes
    `DeviceState`, on a topic named after the module.
    """

    # Commands wait for the end of a look at the device.
    wait_s = 0.0

    bit_rate: int = setting(BIT_RATE, "bit/s of the unit's line", minimum=600)
    rate_rad_per_s: float = setting(1.0, "speed of each joint", minimum=0.01)
    max_age_s: float = LOOK_AGE_S

    def setup(self) -> None:
        """Create the driver."""
        super().setup()
        assert isinstance(self.device, FlirPanTilt)
        self.unit = self.device
        self.by_hand = PanTiltByHand(self, self.unit, self.max_age_s)

    def open_device(self) -> FlirPanTilt:
        """Return the driver."""
        return FlirPanTilt(
            self.url, self.rate_rad_per_s, self.bit_rate, clock=self.time_s, silence_s=self.silence_s
        )

    def on_value(self, value: PanTiltState) -> None:
        """Publish the direction, and the unit's limits once it has reported them."""
        self.by_hand.offer(self.unit.limits)
        self.by_hand.tick()
        self.checkpoint({"orders": self.by_hand.orders.memory})
        self.publish(
            JointState(
                header=Header(stamp=Time.from_nanoseconds(round(value.stamp_s * 1e9))),
                name=JOINTS,
                position=np.array([value.pan_rad, value.tilt_rad]),
                velocity=np.array([value.pan_rad_per_s, value.tilt_rad_per_s]),
            ),
            topic=TOPIC,
        )
