"""The robot's laser range finder, if it is a Hokuyo."""

from robbie_mp import setting
from robbie_robots.hw.hokuyo.laser import HokuyoLaser, SentMeasurements
from robbie_robots.modules.devices.pluggable_laser import PluggableLaserModule


class HokuyoLaserRangeFinder(PluggableLaserModule):
    """A Hokuyo laser with SCIP 2 on a serial port, USB or TCP, such as the URG-04LX or the UST-10LX."""

    port: str = setting("/dev/ttyACM0", "port of the laser: a path, or socket://HOST:10940")
    data: SentMeasurements = setting(
        SentMeasurements.RANGES, "what it measures: MD ranges, MS ranges up to 4.095 m, ME intensities too"
    )
    merge: int = setting(1, "steps of the laser that become one beam", minimum=1, maximum=99)
    skip: int = setting(0, "sweeps to skip after each one", minimum=0, maximum=9)
    latency_s: float = setting(
        0.0, "shortest time from the laser's stamp to the arrival of a sweep", minimum=0.0
    )

    def open_device(self) -> HokuyoLaser:
        """Return the driver."""
        return HokuyoLaser(
            self.url,
            data=self.data,
            merge=self.merge,
            skip=self.skip,
            latency_s=self.latency_s,
            clock=self.time_s,
            silence_s=self.silence_s,
        )
