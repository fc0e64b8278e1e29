"""Matching finds the pose at which a sweep was taken."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.laser.surface_points import SurfacePoints
from robbie_robots.workers.mapping.correlative_search import ScoreField, SearchWindow, search
from robbie_robots.workers.mapping.scan_matcher import ScanMatcher
from robbie_robots.workers.planar_pose import compose, relative
from tests._support.present import present
from tests.workers._support.synthetic_room import ANGLE_MIN_RAD, INCREMENT_RAD, RANGE_MAX_M, measure

HERE = np.array([2.5, 1.5, 0.4])
OFFSETS = [(0.25, -0.2, 0.15), (-0.3, 0.1, -0.3), (0.0, 0.0, 0.0), (0.1, 0.3, 0.35)]


def sweep_at(pose: ArrayLike, seed: int = 0, noise_m: float = 0.01) -> LaserSweep:
    ranges = measure(np.asarray(pose, float), np.random.default_rng(seed), noise_m)
    return LaserSweep.from_ranges(ranges, ANGLE_MIN_RAD, INCREMENT_RAD, 0.05, RANGE_MAX_M)


@pytest.fixture(scope="module")
def reference() -> SurfacePoints:
    poses = [HERE, compose(HERE, [0.4, 0.1, 0.3]), compose(HERE, [-0.4, 0.0, -0.4])]
    return SurfacePoints.joined([sweep_at(pose, seed).hits.moved(pose) for seed, pose in enumerate(poses)])


@pytest.mark.parametrize("offset", OFFSETS)
def test_search_finds_the_pose_within_a_cell(
    reference: SurfacePoints, offset: tuple[float, float, float]
) -> None:
    true = compose(HERE, [0.2, 0.1, 0.1])
    field = ScoreField(reference.points, 0.1, 0.1, reach_m=0.5)
    found = present(search(field, sweep_at(true, 7).hits.points, true + offset, SearchWindow(0.5, 0.5)))
    assert np.abs(relative(true, found.pose)[:2]).max() < 0.1
    assert abs(relative(true, found.pose)[2]) < 0.05
    assert found.score > 0.7


@pytest.mark.parametrize("offset", OFFSETS)
def test_search_and_refinement_find_the_pose_within_a_centimetre(
    reference: SurfacePoints, offset: tuple[float, float, float]
) -> None:
    true = compose(HERE, [0.2, 0.1, 0.1])
    hits = sweep_at(true, 7).hits
    field = ScoreField(reference.points, 0.1, 0.1, reach_m=0.5)
    start = present(search(field, hits.points, true + offset, SearchWindow(0.5, 0.5)))
    match = ScanMatcher(reference).refine(hits, start.pose)
    error = relative(true, match.pose)
    assert np.hypot(error[0], error[1]) < 0.01
    assert abs(error[2]) < np.radians(0.3)
    assert match.on_surface.mean() > 0.9


def test_search_agrees_with_exhaustive_search(reference: SurfacePoints) -> None:
    true = compose(HERE, [0.2, 0.1, 0.1])
    points, guess = sweep_at(true, 3).hits.points[::6], true + np.array([0.2, -0.3, 0.1])
    window = SearchWindow(0.4, 0.2, doubt_per_m2=0.5, doubt_per_rad2=1.0)
    field = ScoreField(reference.points, 0.1, 0.1, reach_m=0.4)
    found = present(search(field, points, guess, window))
    farthest = np.percentile(np.hypot(*points.T), 90)
    turns = np.linspace(-0.2, 0.2, 2 * int(np.ceil(0.2 / (0.1 / farthest))) + 1)
    best = -np.inf
    for turn in turns:
        placed = SurfacePoints(points, np.zeros_like(points)).moved([*guess[:2], guess[2] + turn]).points
        cells = np.floor(placed / 0.1).astype(int) - field.corner
        for right in range(-4, 5):
            for up in range(-4, 5):
                fit = field.level(0)[cells[:, 1] + up, cells[:, 0] + right].mean()
                best = max(best, fit - 0.5 * (right**2 + up**2) * 0.01 - turn**2)
    assert found.score == pytest.approx(best, abs=1e-6)


def test_search_finds_nothing_where_nothing_fits(reference: SurfacePoints) -> None:
    field = ScoreField(reference.points, 0.1, 0.1, reach_m=0.3)
    away = np.column_stack([np.linspace(30, 40, 50), np.zeros(50)])
    assert search(field, away, HERE, SearchWindow(0.3, 0.2), least_score=0.1) is None


def test_corridor_leaves_the_position_along_it_open() -> None:
    along = np.linspace(-10, 10, 400)
    walls = [np.column_stack([along, np.full(400, side)]) for side in (-1.0, 1.0)]
    facing = [np.tile([0.0, -np.sign(wall[0, 1])], (400, 1)) for wall in walls]
    corridor = SurfacePoints(np.concatenate(walls), np.concatenate(facing))
    hits = SurfacePoints(corridor.points[100:700:5], corridor.normals[100:700:5])
    match = ScanMatcher(corridor).refine(hits, [0.2, 0.1, 0.02])
    assert abs(match.pose[1]) < 0.005
    assert match.information[0, 0] < 1e-3 * match.information[1, 1]


def test_odometry_decides_what_the_walls_leave_open() -> None:
    along = np.linspace(-10, 10, 400)
    corridor = SurfacePoints(np.column_stack([along, np.ones(400)]), np.tile([0.0, -1.0], (400, 1)))
    hits = SurfacePoints(corridor.points[100:300:5], corridor.normals[100:300:5])
    prior = np.array([0.5, 0.05, 0.0])
    match = ScanMatcher(corridor).refine(hits, [0.1, 0.1, 0.02], prior, np.diag([100.0, 100.0, 100.0]))
    assert match.pose == pytest.approx([0.5, 0.0, 0.0], abs=0.005)


def test_places_that_a_sweep_looked_through_are_free_and_hits_are_not() -> None:
    sweep = sweep_at((2.0, 1.0, 0.0), noise_m=0.0)
    in_front, behind_the_wall, out_of_view = [1.0, 0.0], [3.0, -1.5], [-1.0, 0.0]
    assert sweep.looked_through([in_front, behind_the_wall, out_of_view]).tolist() == [True, False, False]


def test_noise_of_the_normals_is_no_knowledge_along_a_bare_corridor() -> None:
    random, along = np.random.default_rng(0), np.linspace(-10, 10, 400)
    points = np.concatenate([np.column_stack([along, np.full(400, side)]) for side in (-1.0, 1.0)])
    tilt = 0.05 * random.standard_normal(800)
    facing = np.column_stack([np.sin(tilt), -np.sign(points[:, 1]) * np.cos(tilt)])
    corridor = SurfacePoints(points + 0.01 * random.standard_normal((800, 2)), facing)
    hits = SurfacePoints(corridor.points[100:700:3], corridor.normals[100:700:3])
    match = ScanMatcher(corridor).refine(hits, [0.0, 0.05, 0.02])
    along_m, across_m, _ = np.sqrt(np.diag(np.linalg.inv(match.information + 1e-3 * np.eye(3))))
    assert along_m > 0.2
    assert across_m < 0.02
    fused = match.fused(np.array([0.4, 0.3, 0.0]), np.array([0.1, 0.1, 0.1]))
    assert fused.pose[:2] == pytest.approx([0.4, 0.0], abs=0.1)
    assert fused.known[0] < 0.5 < fused.known[1]
