"""Free ways along arcs are exact; the driver touches nothing and is fast."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.course import as_yaml, random_course
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.parcours.race_driver import RaceDriver, RaceLimits, free_ways, moved
from tools.trials.driving.parcours import race

RADIUS_M = 0.3


def free_by_steps(point: tuple[float, float], curvature: float, limit_m: float) -> float:
    """Drive an arc in small steps until the disc touches the point."""
    for way_m in np.arange(0.0, limit_m, 0.002):
        x_m, y_m = moved(np.array([point]), np.array([curvature]), np.array([way_m]))[0, 0]
        if math.hypot(x_m, y_m) < RADIUS_M:
            return float(way_m)
    return limit_m


@pytest.mark.slow
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-2, 2))
@settings(max_examples=25, deadline=None)
def test_free_way_is_where_the_disc_touches(x_m: float, y_m: float, curvature: float) -> None:
    limit_m = min(3.0, 2 * math.pi / max(abs(curvature), 1e-3) - 0.1)
    if math.hypot(x_m, y_m) <= RADIUS_M + 0.01:
        return  # it overlaps at the start
    found = float(free_ways(np.array([[x_m, y_m]]), np.array([curvature]), RADIUS_M, limit_m)[0])
    stepped = free_by_steps((x_m, y_m), curvature, limit_m)
    grazes = free_by_steps((x_m, y_m), curvature + 1e-3, limit_m) == limit_m or stepped == limit_m
    assert found == pytest.approx(stepped, abs=0.02) or grazes


def test_no_points_leave_every_way_free() -> None:
    assert (free_ways(np.zeros((0, 2)), np.linspace(-1, 1, 5), RADIUS_M, 4.0) == 4.0).all()


def test_robot_can_stop_before_what_it_sees() -> None:
    limits = RaceLimits()
    for free_m in (0.05, 0.3, 2.0):
        speed = float(limits.stopping(np.array([free_m]))[0])
        way_m = speed * limits.reaction_s + speed**2 / (2 * limits.braking_m_per_s2)
        assert way_m == pytest.approx(free_m)


def test_blind_laser_does_not_stop_the_arithmetic() -> None:
    driver = RaceDriver()

    def speeds(ranges_m: float) -> tuple[float, float]:
        sweep = LaserSweep.from_ranges(np.full(360, ranges_m), -math.pi, math.pi / 180, 0.05, 10.0)
        return driver.drive(sweep, 0.0)

    for ranges_m in (np.inf, np.nan, -np.inf, 0.1):
        assert all(map(math.isfinite, speeds(ranges_m)))
    assert speeds(0.1)[0] == 0.0, "there is no way ahead"
    assert speeds(-np.inf)[0] == 0.0, "what is too near to measure leaves no way either"


@pytest.mark.slow
def test_robot_races_without_a_touch_and_nearly_as_fast_as_one_that_knows_the_course() -> None:
    one = race(random_course(4), 4, laps=1)
    assert one.touches == 0
    assert one.ratio > 0.7


def test_course_is_read_back_from_its_file(tmp_path: Path) -> None:
    course = random_course(4)
    file = tmp_path / "course.yaml"
    file.write_text(as_yaml(course))
    arena = read_arena(file)
    assert arena.start[:2] == pytest.approx(course.arena.start[:2], abs=0.2)
    assert len(arena.circles) == 6
