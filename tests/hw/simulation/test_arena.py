"""Rays and clearances in an arena agree with analytic geometry."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from robbie_robots.hw.pose import ORIGIN, Pose, wrapped
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.box_segments import box_segments


def room(circles: Sequence[tuple[float, float, float]] = ()) -> Arena:
    """4 m by 2 m, empty but for circles."""
    walls = box_segments(np.array([[0.0, 0.0, 4.0, 2.0]]))
    return Arena(walls, np.array(circles, dtype=float).reshape(-1, 3), ORIGIN, 4.0, 2.0)


@pytest.mark.parametrize(
    ("degrees", "expected_m"),
    [(0, 3.0), (90, 1.5), (180, 1.0), (270, 0.5), (45, 1.5 * math.sqrt(2)), (-30, 1.0)],
)
def test_ray_ends_at_the_wall(degrees: int, expected_m: float) -> None:
    assert room().ranges_m(1.0, 0.5, np.radians([degrees]))[0] == pytest.approx(expected_m)


def test_ray_ends_at_the_near_side_of_a_circle() -> None:
    circle = room([(3.0, 0.5, 0.25)])
    # Along the axis, and along a tangent line 0.15 m beside it: 0.2 m before the middle, as 0.15, 0.2, 0.25.
    assert circle.ranges_m(1.0, 0.5, np.array([0.0]))[0] == pytest.approx(1.75)
    assert circle.ranges_m(1.0, 0.65, np.array([0.0]))[0] == pytest.approx(1.8)


def test_ray_misses_a_circle_behind_its_start() -> None:
    assert room([(0.5, 0.5, 0.25)]).ranges_m(1.0, 0.5, np.array([0.0]))[0] == pytest.approx(3.0)


def test_ray_from_inside_a_circle_ends_at_its_far_side() -> None:
    assert room([(1.0, 0.5, 0.25)]).ranges_m(1.1, 0.5, np.array([0.0]))[0] == pytest.approx(0.15)


def test_no_ray_passes_through_a_corner() -> None:
    to_corners = np.arctan2([-1.0, -1.0, 1.0, 1.0], [-1.0, 3.0, -1.0, 3.0])
    np.testing.assert_allclose(room().ranges_m(1.0, 1.0, to_corners), np.hypot([1, 3, 1, 3], 1.0))


def test_ray_that_hits_nothing_is_infinite() -> None:
    wall = Arena(np.array([[1.0, -1.0, 1.0, 1.0]]), np.empty((0, 3)), ORIGIN, 2.0, 2.0)
    assert wall.ranges_m(0.0, 0.0, np.array([0.0, np.pi])).tolist() == [1.0, math.inf]


def test_ranges_agree_with_clearance() -> None:
    """The nearest of very many rays is the distance to the nearest surface."""
    arena = room([(3.0, 1.2, 0.25)])
    angles = np.linspace(-np.pi, np.pi, 7200)
    for point in np.random.default_rng(1).uniform([0.1, 0.1], [2.5, 1.9], (20, 2)):
        clearance_m = float(arena.clearance_m(point))
        assert arena.ranges_m(float(point[0]), float(point[1]), angles).min() == pytest.approx(
            clearance_m, abs=1e-3
        )


def test_clearance_of_many_points_equals_that_of_each() -> None:
    arena = room([(3.0, 1.0, 0.25)])
    points = np.array([[[1.0, 0.5], [2.5, 1.0]], [[0.1, 1.9], [3.9, 1.0]]])
    np.testing.assert_allclose(arena.clearance_m(points), [[0.5, 0.25], [0.1, 0.1]])


def test_arc_of_a_quarter_circle_ends_at_the_right_pose() -> None:
    pose = ORIGIN.after_arc(math.pi / 2, math.pi / 2)
    assert pose == pytest.approx((1.0, 1.0, math.pi / 2))


def test_driving_an_arc_back_returns_to_the_start() -> None:
    there = Pose(1.0, 2.0, 3.0).after_arc(0.7, 0.4)
    assert there.after_arc(-0.7, -0.4) == pytest.approx((1.0, 2.0, 3.0))


def test_angles_are_wrapped_to_half_turns() -> None:
    assert wrapped(math.pi) == pytest.approx(math.pi)
    assert wrapped(-math.pi) == pytest.approx(math.pi)
    assert wrapped(2 * math.pi + 0.5) == pytest.approx(0.5)
