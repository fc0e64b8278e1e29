"""The robot's laser range finder, if it is a SICK LMS200, 211, 220, 221 or 291."""

from robbie_mp import setting
from robbie_robots.hw.sick.lms2xx import SickLms2xx
from robbie_robots.modules.devices.pluggable_laser import PluggableLaserModule


class SickLms2xxRangeFinder(PluggableLaserModule):
    """A SICK LMS2xx on a serial line."""

    bit_rate: int = setting(38_400, "bit/s of the stream: 9600, 19200, 38400 or 500000")
    field_deg: int = setting(180, "field of view: 100 or 180 degrees")
    resolution_deg: float = setting(0.5, "angle between beams: 1, 0.5 or, with 100 degrees, 0.25")
    range_max_m: float = setting(8.0, "longest range of the scanner's mode", minimum=1.0)
    range_bits: int = setting(13, "bits of a distance: 13, 14 or 15, by the mode", minimum=13, maximum=15)
    latency_s: float = setting(
        0.0, "shortest time from the last beam to the arrival, without that of the transmission", minimum=0.0
    )

    def open_device(self) -> SickLms2xx:
        """Return the driver."""
        return SickLms2xx(
            self.url,
            bit_rate=self.bit_rate,
            field_deg=self.field_deg,
            resolution_deg=self.resolution_deg,
            range_bits=self.range_bits,
            range_max_m=self.range_max_m,
            latency_s=self.latency_s,
            clock=self.time_s,
            silence_s=self.silence_s,
        )
