"""A slip of odometry is noticed and undone, and a robot that is lost on its map says so."""

from copy import deepcopy

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.grid_mapper import GridMapper
from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.scan_matcher import ScanMatcher
from robbie_robots.workers.mapping.slip_watch import MOST_LOST, SlipWatch
from robbie_robots.workers.planar_pose import compose, relative
from tests.workers._support.synthetic_room import ANGLE_MIN_RAD, INCREMENT_RAD, RANGE_MAX_M, Drive, measure
from tools.trials.driving.slips import SLIP_M, SLIP_RAD, trial

BEAMS = (ANGLE_MIN_RAD, INCREMENT_RAD, 0.05, RANGE_MAX_M)
SWEEP_STEPS = 10


def swept(pose: NDArray[np.float64], seed: int) -> LaserSweep:
    return LaserSweep.from_ranges(measure(pose, np.random.default_rng(seed)), *BEAMS)


def run(
    mapper: GridMapper, drive: Drive, begin: int, end: int, slip: tuple[float, float, float]
) -> GridMapper:
    """Drive. From `begin` on, odometry includes a motion that has not happened."""
    slipped = compose(drive.odometry[begin, 1:], slip)
    for number in range(begin, end):
        stamp = drive.odometry[number, 0]
        odometry = compose(slipped, relative(drive.odometry[begin, 1:], drive.odometry[number, 1:]))
        mapper.add_odometry(stamp, odometry)
        if number % SWEEP_STEPS == 0:
            mapper.add_scan(
                stamp,
                swept(drive.true_at(stamp), number),
            )
    return mapper


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive.around_the_pillar(11.0)


@pytest.fixture(scope="module")
def mapped(drive: Drive) -> GridMapper:
    return run(GridMapper(), drive, 0, 400, (0, 0, 0))


@pytest.mark.parametrize("slip", [(SLIP_M, 0, SLIP_RAD), (-0.7, 0.7, -SLIP_RAD)])
def test_slip_of_odometry_is_noticed_and_undone(
    drive: Drive, mapped: GridMapper, slip: tuple[float, float, float]
) -> None:
    assert not mapped.slips_noticed
    mapper = run(GridMapper.from_state(deepcopy(mapped.state())), drive, 400, 501, slip)
    assert (mapper.slips_noticed, mapper.slips_not_undone) == (1, 0)
    assert mapper.is_certain
    error = relative(drive.true[:501, 1:], mapper.trajectory()[:, 1:])
    off_m = np.hypot(error[:, 0], error[:, 1])
    assert off_m[-80:].max() < 0.06
    assert off_m.max() < 0.15  # between the slip and the next sweep, too


@pytest.mark.slow
def test_lost_robot_says_so_and_continues_with_a_new_part_of_the_map(
    drive: Drive, mapped: GridMapper
) -> None:
    mapper = GridMapper.from_state(deepcopy(mapped.state()))
    place, stamp_s = compose(drive.odometry[400, 1:], [0.1, 0, 0]), 200.0
    elsewhere = np.where(np.arange(180) % 60 < 30, 0.7, 1.2)  # a star, which fits nowhere in the room
    mapper.add_odometry(stamp_s, place)
    for number in range(MOST_LOST):
        assert mapper.is_certain == (number == 0)
        mapper.add_scan(stamp_s, LaserSweep.from_ranges(elsewhere, *BEAMS))
        stamp_s += 0.2
        mapper.add_odometry(stamp_s, place)
    keys = mapper.key_sweeps
    restored = GridMapper.from_state(deepcopy(mapper.state()))
    assert not restored.is_certain
    for one in (mapper, restored):
        one.add_scan(stamp_s, LaserSweep.from_ranges(elsewhere, *BEAMS))
        assert (one.is_certain, one.slips_not_undone, one.key_sweeps) == (True, 1, keys + 1)
        one.add_odometry(stamp_s + 0.2, compose(place, [0.06, 0, 0]))
        one.add_scan(stamp_s + 0.2, LaserSweep.from_ranges(elsewhere, *BEAMS))
        assert one.is_certain


def seen_in_a_corridor(x_m: float) -> LaserSweep:
    """A sweep from the middle of a corridor that is 2 m wide and ends at x = 20 m."""
    bearings = ANGLE_MIN_RAD + INCREMENT_RAD * np.arange(180)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(1 / np.abs(np.sin(bearings)), (20 - x_m) / np.cos(bearings).clip(0))
    ranges += 0.005 * np.random.default_rng(round(10 * x_m)).standard_normal(180)
    return LaserSweep.from_ranges(ranges, ANGLE_MIN_RAD, INCREMENT_RAD, 0.05, 8.0)


def test_sweep_that_fits_two_places_is_not_placed_until_others_decide() -> None:
    keys = KeySweeps()
    for x_m in np.arange(0.0, 16.5, 0.5):
        keys.add(seen_in_a_corridor(x_m), (x_m, 0, 0))
    reference = list(range(20, 33))
    watch, matcher, deviation = SlipWatch(keys), ScanMatcher(keys.surfaces(reference)), np.full(3, 0.05)

    def checked(x_m: float) -> NDArray[np.float64] | None:
        sweep, guess = seen_in_a_corridor(x_m), np.array([x_m, 0.7, 0.0])
        match = watch.checked(sweep, guess, deviation, matcher.refine(sweep.hits, guess), reference)
        return None if match is None else match.pose

    assert checked(10.0) is None
    assert checked(10.5) is None
    assert watch.lost == 2
    restored = SlipWatch(keys)
    restored.restore(deepcopy(watch.state()))
    for one in (watch, restored):
        watch = one
        assert checked(17.5) == pytest.approx([17.5, 0, 0], abs=0.03)
        assert (watch.noticed, watch.not_undone, watch.lost) == (1, 0, 0)


def test_new_space_does_not_tell_a_lost_robot_where_it_is() -> None:
    """It agrees with everything, so the robot was sure of odometry's place right after a slip."""
    keys = KeySweeps()
    for x_m in np.arange(0.0, 16.5, 0.5):
        keys.add(seen_in_a_corridor(x_m), (x_m, 0, 0))
    reference, deviation = list(range(20, 33)), np.full(3, 0.05)
    matcher, beyond = ScanMatcher(keys.surfaces(reference)), np.array([10.0, 50.0, 0.0])
    nowhere = LaserSweep.from_ranges(np.where(np.arange(180) % 60 < 30, 0.3, 0.6), *BEAMS)
    for sweeps, is_known in (([seen_in_a_corridor(1.0)], True), ([nowhere, seen_in_a_corridor(1.0)], False)):
        watch = SlipWatch(keys)
        for sweep in sweeps:
            guess = np.array([16.0, 0.0, 0.0]) if sweep is nowhere else beyond
            found = watch.checked(sweep, guess, deviation, matcher.refine(sweep.hits, guess), reference)
        assert (found is not None) == is_known
        assert (watch.lost == 0) == is_known


@pytest.mark.slow
def test_trial_is_not_misled_by_a_wrong_place_that_fits() -> None:
    building = trial(13, slips=1, after_m=1.0)
    assert building.slips[0].is_good
    assert building.slips[0].unwarned_m < 0.1


@pytest.mark.slow
def test_slip_to_where_the_scan_hardly_overlaps_the_map_is_noticed() -> None:
    """The few returns on known surfaces agreed, so the pose counted as certain, 1.5 m off."""
    building = trial(10, slips=2)
    assert [slip.is_good for slip in building.slips] == [True, True]
    assert max(slip.unwarned_m for slip in building.slips) < 0.1


@pytest.mark.slow
def test_trial_notices_a_slip_in_a_random_building() -> None:
    building = trial(0, slips=1, before_m=6.0, after_m=1.0)
    assert building.false_alarms == 0
    assert building.slips[0].is_good
