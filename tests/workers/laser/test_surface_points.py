"""Beams that graze a wall show the wall, and not things that stand on it."""

import numpy as np
import pytest

from robbie_robots.workers.laser.surface_points import FILLED_M, FILLING_M, SurfacePoints

DEG = np.radians(1.0)
BEARINGS = np.radians(np.arange(4.0, 91.0))


def wall(side_m: float = 1.5, noise_m: float = 0.0) -> SurfacePoints:
    """A wall to the left, up to 21 m ahead, as a laser of 1 degree sees it."""
    ranges = side_m / np.sin(BEARINGS) + noise_m * np.random.default_rng(0).standard_normal(len(BEARINGS))
    return SurfacePoints.from_bearings(BEARINGS, ranges, DEG)


def test_far_end_of_a_wall_has_its_normal() -> None:
    seen = wall(noise_m=0.01)
    assert np.hypot(*np.diff(seen.points[:2], axis=0)[0]) > 2
    assert seen.normals[:, 1] == pytest.approx(-1, abs=0.05)


def test_gaps_of_a_wall_are_filled_up_to_a_width() -> None:
    seen = wall()
    filled = seen.filled()
    assert filled.points[:, 1] == pytest.approx(1.5, abs=0.02)
    gaps = np.diff(np.sort(filled.points[:, 0]))
    widest = np.hypot(*np.diff(seen.points, axis=0).T)
    assert (gaps > 2 * FILLING_M).sum() == (widest >= FILLED_M).sum()


def test_points_that_stand_alone_get_no_normal_and_are_not_joined() -> None:
    ranges = np.array([3.0, 9.0, 18.0, 6.0])[np.arange(40) % 4]
    seen = SurfacePoints.from_bearings(3 * DEG * np.arange(40.0), ranges, 3 * DEG)
    assert not seen.normals.any()
    assert len(seen.filled()) == len(seen)


def test_person_before_a_wall_is_narrow_and_the_wall_is_not_even_where_beams_graze_it() -> None:
    bearings = np.radians(np.arange(4.0, 91.0))
    ranges = 1.5 / np.sin(bearings)
    ranges[56:66] = 1.0
    narrow = SurfacePoints.from_bearings(bearings, ranges, DEG).narrow()
    assert np.flatnonzero(narrow).tolist() == list(range(56, 66))


@pytest.mark.parametrize("degrees", [0.25, 1.0, 2.0, 4.0])
def test_short_walls_have_normals_whatever_the_angle_between_beams(degrees: float) -> None:
    """At 2 degrees and more, a wall had a normal only where five beams in succession hit it."""
    bearings = np.radians(degrees * np.arange(-6.0, 6.0))
    depth_m = np.repeat([4.0, 7.0, 5.0], 4)  # of walls that face the laser
    seen = SurfacePoints.from_bearings(bearings, depth_m / np.cos(bearings), np.radians(degrees))
    assert seen.normals == pytest.approx(np.tile([-1.0, 0.0], (12, 1)), abs=0.05)
