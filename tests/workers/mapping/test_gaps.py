"""A pause without sweeps, in which the robot drove on, is bridged or counted as open."""

from copy import deepcopy

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.grid_mapper import GridMapper
from robbie_robots.workers.mapping.pose_graph import PoseGraph
from robbie_robots.workers.planar_pose import compose, relative
from tests.workers._support.synthetic_room import ANGLE_MIN_RAD, INCREMENT_RAD, RANGE_MAX_M, Drive, measure

BEAMS = (ANGLE_MIN_RAD, INCREMENT_RAD, 0.05, RANGE_MAX_M)
SWEEP_STEPS = 10
GAP, LATE_GAP = (200, 450), (1000, 1250)  # steps of 0.02 s: some 3 m of way, in the first lap and the next


def swept(pose: NDArray[np.float64], seed: int) -> LaserSweep:
    return LaserSweep.from_ranges(measure(pose, np.random.default_rng(seed)), *BEAMS)


def run(mapper: GridMapper, drive: Drive, gap: tuple[int, int], with_odometry: bool = True) -> GridMapper:
    """Feed a log from which the sweeps of a gap are cut, and perhaps the odometry too."""
    for number, (stamp, *odometry) in enumerate(drive.odometry.tolist()):
        is_cut = gap[0] <= number < gap[1]
        if with_odometry or not is_cut:
            mapper.add_odometry(stamp, odometry)
        if number % SWEEP_STEPS == 0 and not is_cut:
            mapper.add_scan(
                stamp,
                swept(drive.true_at(stamp), number),
            )
    return mapper


def errors_m(drive: Drive, mapper: GridMapper) -> NDArray[np.float64]:
    path = mapper.trajectory()
    true = np.array([drive.true_at(stamp) for stamp in path[:, 0]])
    error = relative(true, path[:, 1:])
    off_m: NDArray[np.float64] = np.hypot(error[:, 0], error[:, 1])
    return off_m


@pytest.mark.parametrize("with_odometry", [pytest.param(True, marks=pytest.mark.slow), False])
def test_gap_in_a_known_room_is_bridged(with_odometry: bool) -> None:
    drive = Drive.around_the_pillar(26.5)
    mapper = run(GridMapper(), drive, LATE_GAP, with_odometry)
    assert (mapper.gaps_noticed, mapper.gaps_open) == (1, 0)
    off_m = errors_m(drive, mapper)
    assert off_m[-70:].max() < 0.06
    assert off_m.max() < 0.15
    restored = GridMapper.from_state(deepcopy(mapper.state()))
    assert (restored.gaps_noticed, restored.gaps_open) == (1, 0)


def test_gap_into_unknown_space_stays_open_until_a_loop_is_closed() -> None:
    drive = Drive.around_the_pillar(27.0)
    mapper = run(GridMapper(max_range_m=1.6), drive, GAP)
    assert (mapper.gaps_noticed, mapper.gaps_open) == (1, 1)
    assert mapper.loops_closed > 0
    assert errors_m(drive, mapper).max() < 0.25


def carried(drive: Drive, begin: int, end: int, is_silent: bool) -> GridMapper:
    """Feed a log in which odometry stands still for a while, or odometry and laser are silent then."""
    mapper = GridMapper()
    put_down = compose(drive.odometry[begin, 1:], relative(drive.odometry[end, 1:], np.zeros(3)))
    for number, (stamp, *_) in enumerate(drive.odometry.tolist()):
        if is_silent and begin <= number < end:
            continue
        read = drive.odometry[begin if begin <= number < end else number, 1:]
        mapper.add_odometry(stamp, compose(put_down, read) if number >= end else read)
        if number % SWEEP_STEPS == 0:
            mapper.add_scan(stamp, swept(drive.true_at(stamp), number))
    return mapper


def test_robot_that_is_carried_in_sight_of_its_laser_is_followed() -> None:
    drive = Drive.around_the_pillar(11.0)
    mapper = carried(drive, 400, 500, is_silent=False)
    assert (mapper.slips_noticed, mapper.slips_not_undone, mapper.gaps_open) == (1, 0, 0)
    assert mapper.is_certain
    off_m = errors_m(drive, mapper)
    assert off_m[400:500].max() < 0.2  # there, odometry is off by more than a metre
    assert off_m[510:].max() < 0.06


def test_robot_that_stops_dead_in_a_short_silence_may_have_been_carried() -> None:
    drive = Drive.around_the_pillar(12.0)
    mapper = carried(drive, 450, 500, is_silent=True)
    assert (mapper.gaps_noticed, mapper.gaps_open) == (1, 0)
    assert errors_m(drive, mapper)[-40:].max() < 0.06


def test_drive_without_a_gap_has_none() -> None:
    mapper = run(GridMapper(), Drive.around_the_pillar(4.0), (0, 0))
    assert mapper.gaps_noticed == 0


def test_sweeps_in_a_pause_of_odometry_in_which_the_robot_turned_are_left_out() -> None:
    """As after a replug of the base: it turned for 0.3 s, and then stood for 1.2 s."""
    drive, mapper, turn_rad = Drive.around_the_pillar(4.0), GridMapper(), 0.35
    run(mapper, drive, (0, 0))
    stamp_s, *odometry = drive.odometry[-1].tolist()

    def turned(stamp: float) -> NDArray[np.float64]:
        return compose(drive.true_at(stamp_s), [0.0, 0.0, min(1.0, (stamp - stamp_s) / 0.3) * turn_rad])

    for number in range(1, 31):
        stamp = stamp_s + 0.1 * number
        if number > 15:
            mapper.add_odometry(stamp - 0.05, compose(odometry, [0.0, 0.0, turn_rad]))
        mapper.add_scan(stamp, swept(turned(stamp), number))
    assert mapper.refused["sweeps in a pause of odometry"] > 5
    assert mapper.slips_noticed == 0
    assert relative(turned(stamp), mapper.pose) == pytest.approx([0.0, 0.0, 0.0], abs=0.01)


def test_slow_odometry_is_no_pause() -> None:
    drive = Drive.around_the_pillar(8.0)
    mapper = GridMapper()
    for number, (stamp, *odometry) in enumerate(drive.odometry.tolist()):
        if number % 30 == 0:
            mapper.add_odometry(stamp, odometry)
        if number % SWEEP_STEPS == 5:
            mapper.add_scan(
                stamp,
                swept(drive.true_at(stamp), number),
            )
    assert mapper.refused["sweeps in a pause of odometry"] == 0
    assert mapper.key_sweeps > 3


def test_loose_edge_counts_as_a_long_way() -> None:
    graph = PoseGraph()
    for number in range(4):
        graph.add_pose((float(number), 0, 0))
    for number, deviation_m in enumerate((0.05, 1.0, 0.05)):
        graph.add_edge(number, number + 1, (1, 0, 0), np.diag([deviation_m**-2, deviation_m**-2, 1e4]))
    assert graph.distances_m(0) == pytest.approx([0, 1, 51, 52], abs=1e-3)
