"""People are left out of the surfaces that the next sweep is matched with."""

import numpy as np

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.key_sweeps import KeySweeps

BEAMS = 91


def seen(person_m: tuple[float, ...]) -> LaserSweep:
    """A wall 3 m ahead, and people 1.5 m ahead, this far to the left."""
    bearings = np.radians(np.linspace(-45, 45, BEAMS))
    ranges = 3 / np.cos(bearings)
    for left_m in person_m:
        ranges[np.abs(1.5 * np.tan(bearings) - left_m) < 0.15] = 1.5
    return LaserSweep.from_ranges(ranges, bearings[0], bearings[1] - bearings[0], 0.05, 30.0)


def test_thing_that_one_sweep_alone_saw_is_left_out_and_one_that_stays_is_not() -> None:
    keys = KeySweeps()
    for walked_m in (-1.0, -0.3):
        keys.add(seen((walked_m, 0.5)), np.zeros(3))
    x, y = keys.lasting_surfaces([0, 1]).points.T
    people = y[x < 2]
    assert len(people) > 10
    assert np.abs(people - 0.5).max() < 0.2
    assert len(keys.surfaces([0, 1]).points) > len(x)
    assert (x > 2.9).sum() == (keys.surfaces([0, 1]).points[:, 0] > 2.9).sum()


def test_sweep_of_narrow_things_alone_keeps_them() -> None:
    keys = KeySweeps()
    ranges = np.where(np.arange(BEAMS) % 8 < 4, 2.0, np.inf)
    keys.add(LaserSweep.from_ranges(ranges, -0.8, np.radians(1.0), 0.05, 30.0), np.zeros(3))
    assert len(keys.lasting_surfaces([0])) == len(keys.surfaces([0]))
