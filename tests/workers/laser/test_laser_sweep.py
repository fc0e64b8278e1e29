"""The geometry of sweeps: what is usable, and where beams look."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import CLEARANCE_M, LaserSweep, UnusableSweeps

DEG = math.pi / 180
FULL = (-math.pi, DEG, 0.05, 10.0)


def taken(ranges: ArrayLike, geometry: Sequence[float] = FULL) -> LaserSweep:
    return LaserSweep.from_ranges(ranges, *geometry)


@pytest.mark.parametrize(
    ("ranges", "geometry", "problem"),
    [
        ([], FULL, "no beams"),
        (np.ones((2, 3)), FULL, "no beams"),
        ([1.0, 1.0], (math.nan, DEG, 0.05, 10.0), "no directions"),
        ([1.0, 1.0], (0.0, math.inf, 0.05, 10.0), "no directions"),
        ([1.0, 1.0], (0.0, 0.0, 0.05, 10.0), "no directions"),
        (np.ones(360), (-180.0, 1.0, 0.05, 10.0), "go round 57.1 times"),
        ([1.0], (0.0, DEG, 0.0, 0.0), "no range between them"),
        ([1.0], (0.0, DEG, math.nan, 10.0), "no range between them"),
        ([1.0], (0.0, DEG, 0.1, math.nan), "no range between them"),
        ([1.0], (0.0, DEG, 5.0, 1.0), "no range between them"),
        (np.full(360, np.nan), FULL, "all are NaN"),
    ],
)
def test_sweep_without_a_valid_geometry_is_unusable_and_has_no_beams(
    ranges: NDArray[np.float64], geometry: Sequence[float], problem: str
) -> None:
    sweep, unusable = taken(ranges, geometry), UnusableSweeps()
    assert problem in sweep.problem
    assert len(sweep) == len(sweep.hits) == len(sweep.points()) == len(sweep.directions) == 0
    assert not sweep.looked_through([(1.0, 0.0)]).any()
    assert not unusable.passes(sweep)
    assert problem in str(unusable)
    assert unusable.passes(taken([np.inf]))
    assert str(unusable) == "; 1 unusable scans"


@pytest.mark.parametrize("beams", [1, 2, 3, 359, 360, 361, 500])
@pytest.mark.parametrize("step", [DEG, -DEG])
def test_sweep_of_any_number_of_beams_is_used_as_it_looks(beams: int, step: float) -> None:
    sweep = taken(np.linspace(1.0, 2.0, beams), (0.3, step, 0.05, 10.0))
    assert not sweep.problem
    bearings = 0.3 + step * np.arange(beams)
    ends = np.linspace(1.0, 2.0, beams)[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
    assert sweep.points()[:: int(math.copysign(1, step))] == pytest.approx(ends)
    assert sweep.hits.points == pytest.approx(sweep.points())
    assert np.diff(sweep.bearings_rad) == pytest.approx(DEG)
    kept = LaserSweep.from_state(sweep.state())
    assert kept.points() == pytest.approx(sweep.points())


def test_lone_beam_needs_no_increment() -> None:
    sweep = taken([2.0], (0.5, 0.0, 0.05, 10.0))
    assert sweep.beams_at(np.array([0.5, -2.0])).tolist()[0] == 0
    assert sweep.beams_at(np.array([0.5, -2.0])).tolist()[1] >= 1


@pytest.mark.parametrize("step", [DEG, -DEG])
def test_place_nearer_than_three_beams_ended_was_looked_through(step: float) -> None:
    sweep = taken(np.full(181, 3.0), (-90 * step, step, 0.05, 10.0))  # ahead, from side to side
    seen = sweep.looked_through([(1.0, 0.0), (3.0 - CLEARANCE_M + 0.01, 0.0), (-1.0, 0.0), (0.5, 2.0)])
    assert seen.tolist() == [True, False, False, True]
    for beams in (1, 2):
        assert not taken(np.full(beams, 3.0), (0.0, step, 0.05, 10.0)).looked_through([(1.0, 0.0)]).any()


def test_beam_of_a_direction_is_found_across_the_ends_of_a_full_sweep() -> None:
    sweep = taken(np.ones(360))
    bearings = np.array([-math.pi, math.pi - DEG / 4, math.pi - DEG, 0.0, 4 * math.pi])
    assert sweep.beams_at(bearings).tolist() == [0, 0, 359, 180, 180]


def test_ranges_outside_the_limits_count_as_rep_117_says() -> None:
    sweep = taken([0.01, -np.inf, -1.0, 0.05, 9.9, 10.0, np.inf, np.nan])
    assert sweep.ranges_m == pytest.approx(
        np.array([-np.inf, -np.inf, -np.inf, 0.05, 9.9, np.inf, np.inf, np.nan]), nan_ok=True
    )
    near = sweep.within(5.0)
    assert near.ranges_m[4] == np.inf
    assert near.range_max_m == 5.0
    assert sweep.within(20.0) is sweep
