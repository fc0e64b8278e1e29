"""The robot's laser range finder, if it is a SICK TiM, LMS1xx or LMS5xx."""

from robbie_mp import setting
from robbie_robots.hw.sick.cola import Dialect
from robbie_robots.hw.sick.cola_laser import SickColaLaser
from robbie_robots.modules.devices.pluggable_laser import PluggableLaserModule


class SickColaRangeFinder(PluggableLaserModule):
    """A SICK TiM, LMS1xx or LMS5xx over TCP."""

    port: str = setting("socket://192.168.0.1:2112", "address of the laser: socket://HOST:PORT")
    dialect: Dialect = setting(Dialect.B, "what the laser speaks at that port: A as text, or B binary")
    intensities: bool = setting(False, "have the laser send intensities, too")
    range_max_m: float = setting(25.0, "longest range of the model", minimum=1.0)
    latency_s: float = setting(
        0.0,
        "shortest time from the transmission of a scan, by its clock, to the arrival",
        minimum=0.0,
    )

    def open_device(self) -> SickColaLaser:
        """Return the driver."""
        return SickColaLaser(
            self.url,
            dialect=self.dialect,
            intensities=self.intensities,
            range_max_m=self.range_max_m,
            latency_s=self.latency_s,
            clock=self.time_s,
            silence_s=self.silence_s,
        )
