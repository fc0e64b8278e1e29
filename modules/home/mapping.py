"""Mapping of a place in which people walk."""

import numpy as np

from modules.mapping import Mapping
from robbie_mp import replace, setting
from robbie_mp.messages import LaserScan
from workers.people.leg_classifier import LegClassifier, without_legs


class MappingAmongPeople(Mapping):
    """Maps as `Mapping` does, but leaves out what may be legs.

    Somebody who stood still would remain on the map until the robot has looked at the place again, and
    block its way. Legs of furniture are left out, too; navigation sees them by the laser.
    """

    leg_probability: float = setting(0.3, "likelier legs are left out", minimum=0.0, maximum=1.0)
    leg_range_m: float = setting(6.0, "farther legs are not left out", minimum=0.5)

    def setup(self) -> None:
        """Read the model of legs."""
        self.legs = LegClassifier.from_file()
        super().setup()

    def on_scan(self, scan: LaserScan) -> None:
        """Add a scan without legs."""
        ranges = without_legs(
            self.legs,
            scan.ranges,
            scan.angle_min,
            scan.angle_increment,
            min(self.leg_range_m, scan.range_max),
            self.leg_probability,
        )
        super().on_scan(replace(scan, ranges=ranges.astype(np.float32)))
