"""The robot's receiver of satellite navigation systems."""

import numpy as np

from robbie_mp import Header, Time, setting
from robbie_mp.messages import NavSatFix, NavSatStatus
from robbie_robots.hw.gnss.receiver import (
    NMEA_BIT_RATE,
    UBX_BIT_RATE,
    NmeaReceiver,
    SatellitePosition,
    UbxReceiver,
)
from robbie_robots.modules.devices.pluggable import PluggableDeviceModule


class ReceiverModule(PluggableDeviceModule[SatellitePosition]):
    """Base of the modules of receivers: they publish `NavSatFix` on topic `gnss`, and `DeviceState`."""

    silence_s: float = setting(
        3.0, "the receiver counts as disconnected when it sends nothing valid for this time", minimum=0.05
    )

    def on_value(self, value: SatellitePosition) -> None:
        """Publish a position, also that there is none."""
        status = NavSatStatus.STATUS_NO_FIX
        if value.has_fix:
            status = NavSatStatus.STATUS_GBAS_FIX if value.is_corrected else NavSatStatus.STATUS_FIX
        spread = np.array([value.horizontal_m, value.horizontal_m, value.vertical_m]) ** 2
        is_known = value.has_fix and bool(np.isfinite(spread).all())
        self.publish(
            NavSatFix(
                header=Header(stamp=Time.from_nanoseconds(round(value.stamp_s * 1e9)), frame_id="gnss"),
                status=NavSatStatus(status=status, service=NavSatStatus.SERVICE_GPS),
                latitude=value.latitude_deg,
                longitude=value.longitude_deg,
                altitude=value.height_m,
                position_covariance=np.diag(spread if is_known else np.zeros(3)).ravel(),
                position_covariance_type=NavSatFix.COVARIANCE_TYPE_APPROXIMATED
                if is_known
                else NavSatFix.COVARIANCE_TYPE_UNKNOWN,
            ),
            topic="gnss",
        )


class NmeaReceiverModule(ReceiverModule):
    """Any receiver that sends NMEA 0183: see `ReceiverModule`."""

    bit_rate: int = setting(NMEA_BIT_RATE, "bit/s of the receiver's port", minimum=300)

    def open_device(self) -> NmeaReceiver:
        """Return the driver."""
        return NmeaReceiver(self.url, self.bit_rate, clock=self.time_s, silence_s=self.silence_s)


class UbxReceiverModule(ReceiverModule):
    """A u-blox receiver: see `ReceiverModule`."""

    bit_rate: int = setting(UBX_BIT_RATE, "bit/s of the receiver's port", minimum=300)

    def open_device(self) -> UbxReceiver:
        """Return the driver."""
        return UbxReceiver(self.url, self.bit_rate, clock=self.time_s, silence_s=self.silence_s)
