"""Mapping of a place in which people walk."""

from robbie_robots.modules.maps.mapping import Mapping
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.people.leg_classifier import LegClassifier
from robbie_robots.workers.people.leg_removal import without_legs

KNOWN_LEG_RANGE_M = 4.0
"""Farther away, everything that is as narrow as a leg and stands by itself is left out."""

LEG_PROBABILITY = 0.3
"""Likelier legs are left out."""


class MappingAmongPeople(Mapping):
    """Maps as `Mapping` does, but leaves out what may be legs.

    Somebody who stands still would remain on the map, block the robot's way, and count as furniture. Things
    as narrow as legs are left out, too, as long as they are far away; navigation sees them by the laser.
    """

    def setup(self) -> None:
        """Read the model of legs."""
        self.legs = LegClassifier.from_file()
        super().setup()

    def mapped(self, sweep: LaserSweep) -> LaserSweep:
        """Return a sweep without legs."""
        return without_legs(self.legs, sweep, probability=LEG_PROBABILITY, known_range_m=KNOWN_LEG_RANGE_M)
