"""The simulated laser measures the arena from its place, with noise of the declared size."""

import numpy as np
import pytest

from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import ORIGIN, Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.laser import LaserNotPlaced, SimulatedLaser

ROOM = Arena(box_segments(np.array([[0.0, 0.0, 4.0, 4.0]])), np.empty((0, 3)), ORIGIN, 4.0, 4.0)
MIDDLE = Pose(2.0, 2.0, 0.0)


def sweep(laser: SimulatedLaser, pose: Pose = MIDDLE) -> np.ndarray:
    laser.place(pose, 1.0)
    return laser.scan().ranges_m


def exact(geometry: LaserGeometry | None = None) -> SimulatedLaser:
    return SimulatedLaser(ROOM, geometry, noise_m=0.0, missing=0.0)


def test_sweep_of_a_laser_before_it_is_placed_is_an_error() -> None:
    with pytest.raises(LaserNotPlaced, match="place"):
        SimulatedLaser(ROOM).scan()


def test_sweep_has_the_stamp_of_its_pose() -> None:
    laser = exact()
    laser.place(MIDDLE, 12.5)
    assert laser.scan().stamp_s == 12.5


def test_beams_have_the_directions_of_the_geometry() -> None:
    laser = exact(LaserGeometry(angle_min_rad=-np.pi / 2, angle_increment_rad=np.pi / 2, beams=3))
    np.testing.assert_allclose(sweep(laser, Pose(1.0, 1.5, 0.0)), [1.5, 3.0, 2.5])
    np.testing.assert_allclose(sweep(laser, Pose(1.0, 1.5, np.pi / 2)), [3.0, 2.5, 1.0], rtol=1e-6)
    assert laser.geometry.angle_max_rad == pytest.approx(np.pi / 2)


def test_mounted_laser_measures_from_its_mount() -> None:
    ahead = LaserGeometry(angle_min_rad=0.0, beams=1, mount=Pose(0.2, 0.1, np.pi / 2))
    # Robot looks along y: the laser is 0.2 m up, 0.1 m left, and looks left.
    np.testing.assert_allclose(sweep(exact(ahead), Pose(2.0, 2.0, np.pi / 2)), [1.9], rtol=1e-6)


def test_too_far_is_plus_infinity_and_too_near_is_minus_infinity() -> None:
    geometry = LaserGeometry(0.0, np.pi, 2, range_min_m=0.5, range_max_m=3.0)
    assert sweep(exact(geometry), Pose(0.3, 2.0, 0.0)).tolist() == [np.inf, -np.inf]


def test_noise_has_its_standard_deviation_and_no_bias() -> None:
    laser = SimulatedLaser(ROOM, LaserGeometry(0.0, 0.0, 360), noise_m=0.02, missing=0.0)
    ranges = np.concatenate([sweep(laser) for _ in range(50)])
    assert ranges.mean() == pytest.approx(2.0, abs=0.001)
    assert ranges.std() == pytest.approx(0.02, rel=0.05)


def test_some_beams_have_no_return() -> None:
    laser = SimulatedLaser(ROOM, missing=0.05)
    lost = np.mean([np.isposinf(sweep(laser)) for _ in range(30)])
    assert lost == pytest.approx(0.05, abs=0.01)


def test_sweeps_depend_only_on_the_seed() -> None:
    first, second, other = (SimulatedLaser(ROOM, seed=seed) for seed in (4, 4, 5))
    for _ in range(3):
        ranges = sweep(first)
        np.testing.assert_array_equal(ranges, sweep(second))
        assert not np.array_equal(ranges, sweep(other))


def test_ranges_are_float32_with_one_per_beam() -> None:
    ranges = sweep(SimulatedLaser(ROOM))
    assert ranges.dtype == np.float32
    assert ranges.shape == (360,)
