"""The robot's laser range finder, if it is an RPLidar."""

from robbie_mp import setting
from robbie_robots.hw.rplidar.laser import RpLidar
from robbie_robots.modules.devices.pluggable_laser import PluggableLaserModule


class RpLidarRangeFinder(PluggableLaserModule):
    """An RPLidar of the A or S series on a serial line."""

    silence_s: float = setting(
        2.0, "the laser counts as disconnected after this time without a turn", minimum=0.5
    )
    bit_rate: int = setting(115_200, "bit/s: 115200 (A1, A2), 256000 (A2M12, A3, S1), 1000000 (S2, S3)")
    mode: str = setting(
        "standard", "standard, typical, express, ultra, dense, hq, or the laser's own name of a mode"
    )
    beams: int = setting(720, "sectors of a turn, of which each gives one range", minimum=36, maximum=7200)
    range_max_m: float = setting(12.0, "longest range of the model", minimum=1.0)

    def open_device(self) -> RpLidar:
        """Return the driver."""
        return RpLidar(
            self.url,
            bit_rate=self.bit_rate,
            mode=self.mode,
            beams=self.beams,
            range_max_m=self.range_max_m,
            clock=self.time_s,
            silence_s=self.silence_s,
        )
