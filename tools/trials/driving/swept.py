"""The newest sweep of a laser driver or a simulated laser, as the workers take it."""

from robbie_robots.hw.laser import LaserRangeFinder
from robbie_robots.workers.laser.laser_sweep import LaserSweep


def swept(laser: LaserRangeFinder) -> LaserSweep:
    """Return a laser's newest sweep, with its geometry."""
    geometry = laser.geometry
    return LaserSweep.from_ranges(
        laser.scan().ranges_m,
        geometry.angle_min_rad,
        geometry.angle_increment_rad,
        geometry.range_min_m,
        geometry.range_max_m,
    )
