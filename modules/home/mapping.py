"""Mapping of a place in which people walk."""

from modules.mapping import Mapping
from robbie_mp import setting
from workers.laser.laser_sweep import LaserSweep
from workers.people.leg_classifier import LegClassifier
from workers.people.leg_removal import without_legs


class MappingAmongPeople(Mapping):
    """Maps as `Mapping` does, but leaves out what may be legs.

    Somebody who stands still would remain on the map, block the robot's way, and count as furniture. Things
    as narrow as legs are left out, too, as long as they are far away; navigation sees them by the laser.
    """

    leg_probability: float = setting(0.3, "likelier legs are left out", minimum=0.0, maximum=1.0)
    known_leg_range_m: float = setting(
        4.0,
        "farther away, everything that is as narrow as a leg and stands by itself is left out",
        minimum=0.5,
    )

    def setup(self) -> None:
        """Read the model of legs."""
        self.legs = LegClassifier.from_file()
        super().setup()

    def mapped(self, sweep: LaserSweep) -> LaserSweep:
        """Return a sweep without legs."""
        return without_legs(
            self.legs, sweep, probability=self.leg_probability, known_range_m=self.known_leg_range_m
        )
