"""The mapper is better than its odometry, respects its limits, and continues from a checkpoint."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.grid_mapper import GridMapper, MapperLimits
from robbie_robots.workers.planar_pose import compose, relative
from tests.workers._support.synthetic_room import (
    ANGLE_MIN_RAD,
    INCREMENT_RAD,
    RANGE_MAX_M,
    SEGMENTS,
    Drive,
    measure,
)

BEAMS = (ANGLE_MIN_RAD, INCREMENT_RAD, 0.05, RANGE_MAX_M)
LAP_S = 2 * np.pi / 0.35


def run(
    mapper: GridMapper,
    drive: Drive,
    laser_pose: ArrayLike = (0, 0, 0),
    begin: int = 0,
    end: int | None = None,
) -> GridMapper:
    """Drive: a sweep with every fifth odometry message, stamped 7 ms after it and sent at once."""
    for number in range(begin, len(drive.odometry) if end is None else end):
        stamp = drive.odometry[number, 0]
        mapper.add_odometry(stamp, drive.odometry[number, 1:])
        if number % 5 == 0:
            seen_from = compose(drive.true_at(stamp + 0.007), laser_pose)
            ranges = measure(seen_from, np.random.default_rng(number))
            mapper.add_scan(stamp + 0.007, LaserSweep.from_ranges(ranges, *BEAMS))
    return mapper


def errors(drive: Drive, poses: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    error = relative(drive.true[:, 1:], poses)
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive.around_the_pillar(2.2 * LAP_S)


@pytest.fixture(scope="module")
def mapped(drive: Drive) -> GridMapper:
    return run(GridMapper(), drive)


@pytest.mark.slow
def test_trajectory_is_better_than_odometry(drive: Drive, mapped: GridMapper) -> None:
    distance_m, angle_rad = errors(drive, mapped.trajectory()[:, 1:])
    by_odometry_m, _ = errors(drive, drive.odometry[:, 1:])
    assert by_odometry_m.max() > 0.8
    assert distance_m.mean() < 0.02
    assert distance_m.max() < 0.06
    assert angle_rad.max() < np.radians(1.5)


def test_trajectory_has_a_row_for_every_odometry_message(drive: Drive, mapped: GridMapper) -> None:
    trajectory = mapped.trajectory()
    assert np.array_equal(trajectory[:, 0], drive.odometry[:, 0])
    assert mapped.pose == pytest.approx(trajectory[-1, 1:], abs=0.02)


def test_loops_are_closed(mapped: GridMapper) -> None:
    assert mapped.loops_closed > 5


def test_map_has_its_walls_where_the_room_has_them(mapped: GridMapper) -> None:
    cells, corner, resolution_m = mapped.grid()
    middles = (SEGMENTS[:, :2] + SEGMENTS[:, 2:]) / 2
    for x, y in middles[[0, 1, 2, 4, 5, 6, 7]]:
        column, row = np.floor((np.array([x, y]) - corner) / resolution_m).astype(int)
        assert cells[row - 2 : row + 3, column - 2 : column + 3].max() > 80, (x, y)
    column, row = np.floor((np.array([2.0, 3.0]) - corner) / resolution_m).astype(int)
    assert 0 <= cells[row, column] < 20
    occupied = np.argwhere(cells > 50)[:, ::-1] * resolution_m + corner + resolution_m / 2
    assert np.quantile([_to_walls(point) for point in occupied], 0.95) < 0.08


def _to_walls(point: NDArray[np.float64]) -> float:
    begin, along = SEGMENTS[:, :2], SEGMENTS[:, 2:] - SEGMENTS[:, :2]
    share = np.clip(((point - begin) * along).sum(1) / (along**2).sum(1), 0, 1)
    return float(np.hypot(*(begin + share[:, None] * along - point).T).min())


def test_mounting_pose_of_the_laser_is_taken_into_account(drive: Drive) -> None:
    mount = (0.2, -0.1, 0.3)
    mapper = run(GridMapper(laser_pose=mount), drive, mount, end=900)
    error = relative(drive.true[:900, 1:], mapper.trajectory()[:, 1:])
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.06


@pytest.mark.slow
def test_mapper_restored_from_its_state_continues_identically(drive: Drive) -> None:
    straight = run(GridMapper(), drive, end=1001)  # a sweep is waiting for its odometry
    straight.grid()
    state = deepcopy(straight.state())
    assert len(state["waiting"]) == 1
    assert len(state["keys"]["beams"]) > 30
    second = GridMapper.from_state(state)
    assert_same(second.state(), straight.state())
    for mapper in (straight, second):
        run(mapper, drive, begin=1001, end=1400)
        mapper.grid()
    assert straight.loops_closed > state["loops"]["closed"]
    assert_same(second.state(), straight.state())
    assert np.array_equal(second.trajectory(), straight.trajectory())
    assert np.array_equal(second.grid()[0], straight.grid()[0])


def assert_same(left: Any, right: Any, where: str = "state") -> None:
    """Equal to the last bit; NaN equals NaN."""
    if isinstance(left, dict):
        assert left.keys() == right.keys(), where
        for key in left:
            assert_same(left[key], right[key], f"{where}[{key!r}]")
    elif isinstance(left, list):
        assert len(left) == len(right), where
        for number, (one, other) in enumerate(zip(left, right, strict=True)):
            assert_same(one, other, f"{where}[{number}]")
    elif isinstance(left, np.ndarray):
        assert (left.dtype, left.shape, left.tobytes()) == (right.dtype, right.shape, right.tobytes()), where
    else:
        assert left == right, where


def test_mapper_without_data_can_be_restored(drive: Drive) -> None:
    second = GridMapper.from_state(GridMapper().state())
    assert_same(run(second, drive, end=100).state(), run(GridMapper(), drive, end=100).state())


def test_standing_robot_adds_no_key_sweeps(drive: Drive) -> None:
    mapper = GridMapper()
    ranges = measure(drive.true[0, 1:], np.random.default_rng(0))
    for number in range(50):
        mapper.add_odometry(number * 0.1, drive.true[0, 1:])
        mapper.add_scan(number * 0.1, LaserSweep.from_ranges(ranges, *BEAMS))
    assert len(mapper.state()["keys"]["beams"]) == 1


def test_key_sweeps_beyond_the_limit_are_refused_and_counted(drive: Drive) -> None:
    mapper = run(GridMapper(limits=MapperLimits(key_sweeps=5)), drive, end=600)
    assert len(mapper.state()["keys"]["beams"]) == 5
    assert mapper.refused["sweeps beyond the limit of key sweeps"] > 5
    assert np.isfinite(mapper.trajectory()).all()


@pytest.mark.slow
def test_endless_drive_in_a_room_has_bounded_memory_and_stays_accurate() -> None:
    drive = Drive.around_the_pillar(3.4 * LAP_S)
    mapper = GridMapper(limits=MapperLimits(key_sweeps=90))
    sizes = []
    for begin in range(0, len(drive.odometry), 100):
        run(mapper, drive, begin=begin, end=min(begin + 100, len(drive.odometry)))
        if begin % 500 == 0:
            mapper.grid()
        keys = mapper.state()["keys"]
        sizes.append((len(keys["beams"]), len(keys["graph"]["ends"])))
    assert mapper.thinned > 20
    assert not mapper.refused["sweeps beyond the limit of key sweeps"]
    assert max(keys for keys, _ in sizes) <= 90
    assert max(edges for _, edges in sizes) <= 90 * 4
    off_m, off_rad = errors(drive, mapper.trajectory()[:, 1:])
    assert off_m.mean() < 0.05
    assert off_rad.mean() < 0.02
    second = GridMapper.from_state(deepcopy(mapper.state()))
    assert np.array_equal(second.grid()[0], mapper.grid()[0])
    assert np.array_equal(second.trajectory(), mapper.trajectory())


def test_sweeps_beyond_the_memory_of_the_grid_are_skipped_and_counted(drive: Drive) -> None:
    mapper = run(GridMapper(limits=MapperLimits(cells=11_000)), drive, end=300)
    mapper.grid()
    assert mapper.drawn().bytes < 3_000_000
    assert mapper.refused["sweeps beyond the grid's memory"] > 0


def test_map_drawn_little_by_little_becomes_the_whole_map(mapped: GridMapper) -> None:
    whole = mapped.grid()
    second = GridMapper.from_state(deepcopy(mapped.state()))
    seen, behind = -1, [mapped.key_sweeps]
    while behind[-1]:
        cells, _, _ = second.grid(most_sweeps=20)
        behind.append(second.sweeps_behind)
        assert (cells >= 0).sum() > seen
        seen = int((cells >= 0).sum()) if len(behind) < 3 else seen
    assert behind[1:3] == [mapped.key_sweeps - 20, mapped.key_sweeps - 40]
    assert np.array_equal(second.grid()[0], whole[0])
    assert np.array_equal(second.grid()[1], whole[1])


def test_large_map_is_given_as_a_window_around_the_robot(mapped: GridMapper) -> None:
    cells, corner_m, resolution_m = mapped.grid(most_cells=10_000)
    rows, columns = mapped.known_cells
    assert 8_000 < cells.size <= 10_000 < rows * columns
    middle_m = corner_m + np.array(cells.shape[::-1]) * resolution_m / 2
    assert np.hypot(*(middle_m - mapped.pose[:2])) < 2.5


def test_sweeps_without_odometry_are_refused_and_counted(drive: Drive) -> None:
    mapper = GridMapper()
    ranges = measure(drive.true[0, 1:], np.random.default_rng(0))
    for number in range(15):
        mapper.add_scan(number * 0.1, LaserSweep.from_ranges(ranges, *BEAMS))
    assert mapper.refused["sweeps without odometry"] == 5
    assert mapper.pose.tolist() == [0, 0, 0]
    assert mapper.trajectory().shape == (0, 4)
    assert mapper.grid()[0].size == 0


def test_sweeps_without_returns_are_refused_and_counted() -> None:
    mapper = GridMapper()
    mapper.add_odometry(0.0, (0, 0, 0))
    for nothing in (np.inf, np.nan, 0.0, 99.0, -1.0):
        mapper.add_scan(0.0, LaserSweep.from_ranges(np.full(180, nothing), *BEAMS))
    assert mapper.refused == {"sweeps with too few returns": 4, "unusable sweeps": 1}


def test_sweep_whose_stamp_odometry_never_reaches_is_placed_by_arrival(drive: Drive) -> None:
    mapper = GridMapper()
    ranges = measure(drive.true[0, 1:], np.random.default_rng(0))
    mapper.add_odometry(1.0, drive.true[0, 1:])
    mapper.add_scan(500.0, LaserSweep.from_ranges(ranges, *BEAMS))
    assert mapper.grid()[0].size == 0
    for number in range(5):
        mapper.add_odometry(1.1 + number, drive.true[0, 1:])
    assert mapper.grid()[0].size > 0
