"""Nobody who stands still gets into a scan for the map, and so nobody remains on the map."""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.hw.simulation.people import leg_circles
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.occupancy_grid import GrowingGrid
from robbie_robots.workers.people.leg_classifier import LegClassifier
from robbie_robots.workers.people.leg_removal import without_legs
from robbie_robots.workers.people.map_things import MapThings
from robbie_robots.workers.planar_pose import transform_points
from tests._support.places import ARENAS

LASER = LaserGeometry(angle_increment_rad=0.00613592, beams=1024)
PERSON = (8.0, 1.8)
Ranges = NDArray[np.float64]


@pytest.fixture(scope="module")
def classifier() -> LegClassifier:
    return LegClassifier.from_file()


def cleaned(classifier: LegClassifier, ranges: Ranges) -> Ranges:
    sweep = LaserSweep.from_ranges(ranges, LASER.angle_min_rad, LASER.angle_increment_rad, 0.0, np.inf)
    return without_legs(classifier, sweep, probability=0.3, known_range_m=4.0).ranges_m


def drive(*points: tuple[float, float]) -> Iterator[tuple[Pose, NDArray[np.float64]]]:
    """Yield poses, one every 0.25 m, and the laser's ranges there, while a person stands in the kitchen."""
    arena = read_arena(ARENAS / "apartment.yaml").with_circles(leg_circles(np.array([[*PERSON, 0.7, 0, 0]])))
    laser = SimulatedLaser(arena, LASER, noise_m=0.005, seed=3)
    for (x, y), (next_x, next_y) in pairwise(points):
        steps = max(1, round(math.dist((x, y), (next_x, next_y)) / 0.25))
        for share in np.arange(steps) / steps:
            pose = Pose(x + share * (next_x - x), y + share * (next_y - y), 0.0)
            laser.place(pose, 0.0)
            yield pose, laser.scan().ranges_m.astype(np.float64)


def test_person_who_stands_is_not_on_the_map_and_walls_are(classifier: LegClassifier) -> None:
    grid = GrowingGrid(0.05)
    angles = LASER.angles_rad()
    for pose, ranges in drive(
        (2.0, 2.0), (5.5, 1.8), (6.2, 1.9), (6.9, 3.0), (8.0, 3.6), (8.8, 2.6), (8.8, 1.6)
    ):
        kept = cleaned(classifier, ranges)
        points = (kept[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]))[np.isfinite(kept)]
        grid.add(pose[:2], transform_points(pose, points))
    cells, corner_m = grid.cells()
    things = MapThings(cells, 0.05, corner_m.tolist())
    places = [(x, y) for x, y, _ in leg_circles(np.array([[*PERSON, 0.7, 0, 0]])).tolist()]
    assert not things.at(places).any()
    assert things.at([(5.8, 0.6), (9.15, 1.8), (6.5, 3.0)]).all()


def scan_of(*circles: tuple[float, float, float]) -> Ranges:
    """Return what a laser measures in front of a wall, with round things x, y, radius."""
    angles = LASER.angles_rad()
    with np.errstate(divide="ignore"):
        ranges = np.where(np.cos(angles) > 0.05, 9.0 / np.cos(angles), np.inf)
    for x, y, radius in circles:
        along = x * np.cos(angles) + y * np.sin(angles)
        half = radius**2 - (x**2 + y**2 - along**2)
        hit = (half >= 0) & (along > 0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(half[hit]))
    ranges[ranges > LASER.range_max_m] = np.inf
    return ranges


@pytest.mark.parametrize(
    "circles",
    [
        [(1.5, 0.0, 0.06)],
        [(-1.5, 0.0, 0.06)],  # where a full scan begins and ends
        [(1.5, 0.0, 0.06), (1.68, 0.05, 0.06)],  # half hidden by the other leg
        [(7.0, 0.1, 0.06), (7.0, -0.1, 0.06)],  # farther than legs are known
    ],
)
def test_legs_are_left_out_and_everything_else_is_kept(
    classifier: LegClassifier, circles: list[tuple[float, float, float]]
) -> None:
    ranges, without = scan_of(*circles, (2.0, 2.0, 0.4)), scan_of((2.0, 2.0, 0.4))
    kept = cleaned(classifier, ranges)
    on_leg = ranges != without
    assert on_leg.sum() > 5
    assert np.isnan(kept[on_leg]).all()
    np.testing.assert_array_equal(kept[~on_leg], without[~on_leg])


def test_far_piece_of_wall_between_two_nearer_things_is_kept(classifier: LegClassifier) -> None:
    ranges = scan_of((2.0, 0.53, 0.5), (2.0, -0.53, 0.5))
    np.testing.assert_array_equal(cleaned(classifier, ranges), ranges)
