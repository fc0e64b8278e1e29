"""Sweeps are followed by odometry where they show nothing."""

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.scan_tracker import ScanTracker

RANGE_M, STEP_M = 4.0, 2.8
DEVIATION = np.array([0.33, 0.05, 0.05])


def seen_in_a_bare_corridor(random: np.random.Generator) -> LaserSweep:
    bearings = np.radians(np.arange(-120.0, 121.0))
    with np.errstate(divide="ignore"):
        ranges: NDArray[np.float64] = 1.2 / np.abs(np.sin(bearings))
    ranges += 0.015 * random.standard_normal(len(bearings))
    return LaserSweep.from_ranges(ranges, bearings[0], np.radians(1.0), 0.05, RANGE_M)


def test_bare_corridor_moves_no_match_along_it() -> None:
    """Sweeps were drawn back, where more of them overlaps, and moved by the noise of normals."""
    random, off_m = np.random.default_rng(0), []
    for _ in range(10):
        keys = KeySweeps()
        for number in range(4):
            keys.add(seen_in_a_bare_corridor(random), (number * STEP_M, 0, 0))
        tracker = ScanTracker(keys)
        match = tracker.match(seen_in_a_bare_corridor(random), keys.poses[-1], (STEP_M, 0, 0), DEVIATION)
        assert match.known[0] < 0.2
        assert match.pose[1:] == pytest.approx(0.0, abs=0.02)
        off_m.append(match.pose[0] - 4 * STEP_M)
    assert np.abs(off_m).max() < 0.06
