"""The robot's laser range finder, if it is a Hokuyo."""

from hw.hokuyo.laser import HokuyoLaser
from robbie_mp import Header, Module, Time, setting
from robbie_mp.messages import LaserScan


class HokuyoLaserRangeFinder(Module):
    """A laser on a serial port or USB, such as the URG-04LX.

    If the laser falls silent, this module's process ends; the supervisor restarts it until the laser answers.
    """

    port: str = setting("/dev/ttyACM0", "serial port of the laser")
    timeout_s: float = setting(
        0.5, "the laser counts as silent when it sends nothing for this time", minimum=0.05
    )
    period_s: float = setting(
        0.02, "time between checks for a sweep; less than the laser's scan time", minimum=0.001
    )

    def setup(self) -> None:
        """Open the laser."""
        self.laser = HokuyoLaser(self.port, self._time_s, self.timeout_s)
        self.scans = 0

    def tick(self) -> None:
        """Wait for a sweep and publish it."""
        sweep, geometry = self.laser.scan(), self.laser.geometry
        self.publish(
            LaserScan(
                header=Header(stamp=Time.from_nanoseconds(round(sweep.stamp_s * 1e9)), frame_id="laser"),
                angle_min=geometry.angle_min_rad,
                angle_max=geometry.angle_max_rad,
                angle_increment=geometry.angle_increment_rad,
                scan_time=self.laser.period_s,
                range_min=geometry.range_min_m,
                range_max=geometry.range_max_m,
                ranges=sweep.ranges_m,
            )
        )
        self.scans += 1
        self.status = f"{self.scans} scans of {geometry.beams} beams"

    def teardown(self) -> None:
        """Switch the laser off."""
        self.laser.close()

    def _time_s(self) -> float:
        return self.clock.now_ns() / 1e9
