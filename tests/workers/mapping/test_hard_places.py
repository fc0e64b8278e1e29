"""Where places look alike, or hardly show anything, mapping is not sure of a wrong one."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.grid_mapper import FEWEST_HITS, NOWHERE, GridMapper
from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.loop_closing import LoopCloser
from robbie_robots.workers.mapping.slip_watch import SlipWatch
from robbie_robots.workers.planar_pose import compose, relative
from tests.workers._support.synthetic_room import distances_m

Array = NDArray[np.float64]
BEARINGS = np.radians(np.arange(-90.0, 91.0))
RANGE_M, NOISE_M = 8.0, 0.01
BEGIN = np.array([-6.0, 0.0, 0.0])
STEP_M, STEP_S = 0.1, 0.2
NO_TRUNKS = np.zeros((0, 2))
NO_SLIP = (0.0, 0.0, 0.0)
TRUNK_M = 0.15  # radius; that of a person, too


def walls(*lines: list[tuple[float, float]]) -> Array:
    return np.array([[*one, *other] for line in lines for one, other in pairwise(line)], float)


def corridor(marks_m: ArrayLike = (), width_m: float = 0.0, depth_m: float = 0.0) -> Array:
    """A corridor along x, 2 m wide, with niches that begin at these places of its left wall, or pillars."""
    left = [(-30.0, 1.0)]
    for x in np.asarray(marks_m, float):
        left += [(x, 1.0), (x, 1 + depth_m), (x + width_m, 1 + depth_m), (x + width_m, 1.0)]
    return walls([*left, (30.0, 1.0), (30.0, -1.0), (-30.0, -1.0), (-30.0, 1.0)])


def swept(pose: Array, segments: Array, trunks: Array, range_m: float = RANGE_M) -> LaserSweep:
    directions = np.column_stack([np.cos(BEARINGS + pose[2]), np.sin(BEARINGS + pose[2])])
    to_trunk = trunks - pose[:2]
    ahead, aside = directions @ to_trunk.T, directions @ (to_trunk @ [[0.0, -1.0], [1.0, 0.0]]).T
    with np.errstate(invalid="ignore"):
        to_bark_m = ahead - np.sqrt(TRUNK_M**2 - aside**2)
    to_bark_m = np.where((np.abs(aside) < TRUNK_M) & (ahead > 0), to_bark_m, np.inf)
    ranges = np.minimum(distances_m(pose, BEARINGS, segments), to_bark_m.min(axis=1, initial=np.inf))
    ranges += NOISE_M * np.random.default_rng(round(1e3 * abs(pose[0]))).standard_normal(len(BEARINGS))
    return LaserSweep.from_ranges(ranges, BEARINGS[0], BEARINGS[1] - BEARINGS[0], 0.05, range_m)


class StraightDrive:
    """A robot that drives straight on, with good odometry but for one slip after 8 m.

    Attributes:
        errors: After each sweep from the slip on, `(N, 3)`: how far off the pose is (m, m, rad).
        deviations: What the mapper says of that: standard deviations, `(N, 3)`.
        is_certain: What it says of the pose, `(N,)`.
        mapper: The mapper.
    """

    def __init__(
        self,
        segments: Array,
        slip: ArrayLike = NO_SLIP,
        trunks: Array = NO_TRUNKS,
        way_m: float = 10.0,
        segments_after: Array | None = None,
        range_m: float = RANGE_M,
    ) -> None:
        self.mapper, odometry = GridMapper(max_range_m=range_m), NOWHERE
        random = np.random.default_rng(0)
        errors, deviations, certain = [], [], []
        for number in range(round(way_m / STEP_M)):
            true = compose(BEGIN, [number * STEP_M, 0.0, 0.0])
            noise = 0.002 * random.standard_normal(3) * [1.0, 0.3, 0.5]
            odometry = compose(compose(odometry, [STEP_M if number else 0.0, 0.0, 0.0]), noise)
            has_slipped = number >= round(8.0 / STEP_M)
            if number == round(8.0 / STEP_M):
                odometry = compose(odometry, slip)
            self.mapper.add_odometry(STEP_S * number, odometry)
            seen = segments if segments_after is None or not has_slipped else segments_after
            self.mapper.add_scan(STEP_S * number, swept(true, seen, trunks, range_m))
            if has_slipped:
                errors.append(relative(true, compose(BEGIN, self.mapper.pose)))
                deviations.append(np.sqrt(np.diag(self.mapper.certainty().covariance)))
                certain.append(self.mapper.is_certain)
        self.errors, self.deviations, self.is_certain = map(np.array, (errors, deviations, certain))

    def wrong_and_sure(self) -> NDArray[np.bool_]:
        """Return at which sweeps the mapper was sure of a pose that is far off `(N,)`."""
        wrong = np.abs(self.errors) > np.maximum(3 * self.deviations, [0.2, 0.2, 0.1])
        return np.asarray(self.is_certain & wrong.any(axis=1))


@pytest.mark.parametrize("slip", [(1.0, 0.0, 0.17), (-1.0, 0.0, 0.17), (0.7, 0.7, 0.17), (0.0, 0.6, 0.17)])
def test_slip_in_a_bare_corridor_is_undone_but_for_doubt_along_it(slip: tuple[float, float, float]) -> None:
    """The heading was 0.1 rad off, or the pose a metre along the corridor, and certain."""
    drive = StraightDrive(corridor(), slip)
    assert drive.mapper.slips_noticed == 1
    assert drive.is_certain[-1]
    assert np.abs(drive.errors[-1, 1:]).max() < 0.05
    assert (drive.deviations[drive.is_certain, 0] > 0.9).all()
    assert not drive.wrong_and_sure().any()


@pytest.mark.parametrize(("every_m", "slip"), [(1.6, (-0.8, 0.3, 0.17)), (1.0, (0.5, 0.6, 0.0))])
def test_mapping_is_not_sure_of_the_wrong_one_of_two_equal_niches(
    every_m: float, slip: tuple[float, float, float]
) -> None:
    """The right place overlaps less, because the map ends beyond it, so it was no longer a rival."""
    drive = StraightDrive(corridor(np.arange(-30, 30, every_m), every_m / 2, 0.5), slip, way_m=11.0)
    assert not drive.is_certain[0]
    assert not drive.wrong_and_sure().any()


def test_slip_beside_a_niche_that_tells_one_place_from_others_is_undone() -> None:
    """The control of the one above."""
    drive = StraightDrive(corridor([4.0], 1.0, 0.5), (0.7, 0.7, 0.17))
    assert np.abs(drive.errors[-1]).max() < 0.1
    assert drive.deviations[-1, 0] < 0.5


DOORWAYS, PILLARS = (1.0, 0.8), (0.5, -0.3)  # width and depth, m


@pytest.mark.parametrize(
    ("slip", "shape"),
    [((1, 0, 0.17), PILLARS), ((1, 0, 0.17), DOORWAYS), ((0.7, 0.7, 0.17), DOORWAYS)],
)
def test_slip_in_a_corridor_is_undone_by_what_shows_how_far_along_it_the_robot_is(
    slip: tuple[float, float, float], shape: tuple[float, float]
) -> None:
    """It was off by the slip, with a deviation of 1 m; once sure of a place outside of the corridor."""
    drive = StraightDrive(corridor([-5.0, 1.5, 7.0, 9.5, 14.0], *shape), slip, way_m=11.0)
    assert drive.mapper.slips_noticed == 1
    assert drive.is_certain[-1]
    assert np.abs(drive.errors[-1]).max() < 0.1
    assert drive.deviations[-1, 0] < 0.3
    assert not drive.wrong_and_sure().any()


@pytest.mark.parametrize("before_m", [0.6, 1.2, 2.5])
def test_flat_side_of_a_lorry_is_not_taken_for_the_gate_behind_it(before_m: float) -> None:
    """It hides the gate. To judge only where a scan fits best moves the robot by as much."""
    gate = walls([(8.0, -9.0), (8.0, 9.0)], [(-9.0, 4.0), (-8.0, 4.0)])
    lorry = walls([(8.0 - before_m, -7.0), (8.0 - before_m, 7.0)])
    drive = StraightDrive(gate, segments_after=np.concatenate([gate, lorry]), range_m=20.0)
    assert not drive.wrong_and_sure().any()


def wood(random: np.random.Generator) -> Array:
    trunks = random.uniform([-12.0, -8.0], [14.0, 8.0], (120, 2))
    return trunks[np.abs(trunks[:, 1]) > 0.6]


@pytest.mark.parametrize("slip", [(0.7, 0.7, 0.17), (-0.6, 0.8, -0.17)])
def test_slip_in_a_wood_is_undone(slip: tuple[float, float, float]) -> None:
    """The control of the one below: trunks are as narrow as people, but stay."""
    drive = StraightDrive(np.zeros((0, 4)), slip, wood(np.random.default_rng(0)))
    assert drive.mapper.slips_noticed == 1
    assert drive.is_certain[-1]
    assert np.abs(drive.errors[-1]).max() < 0.1


def test_robot_is_not_found_by_people_after_a_gap() -> None:
    """A few scans of a crowd fitted others 1.3 m off, and bent a map of good odometry."""
    keys, no_walls = KeySweeps(), np.zeros((0, 4))
    keys.add(swept(NOWHERE, no_walls, np.array([(1.5, 0.6), (1.2, -0.8), (2.0, 0.0)])), NOWHERE)
    walked_on = swept(NOWHERE, no_walls, np.array([(1.9, 1.0), (1.6, -0.4), (2.4, 0.4)]))
    assert len(walked_on.hits) > FEWEST_HITS
    assert SlipWatch(keys).bridged(walked_on, NOWHERE, np.array([0.5, 0.5, 0.2])) is None


def test_robot_is_found_after_a_gap_although_a_corridor_leaves_open_how_far_along_it_it_is() -> None:
    """After a slip, mapping waits for sweeps that show it; a gap has only this one."""
    keys = KeySweeps()
    for x in np.arange(-6.0, 6.0, 0.5):
        keys.add(swept(np.array([x, 0.0, 0.0]), corridor(), NO_TRUNKS), (x, 0.0, 0.0))
    guess, deviation = np.array([1.0, 0.3, 0.1]), np.array([0.5, 0.5, 0.2])
    found = SlipWatch(keys).bridged(swept(NOWHERE, corridor(), NO_TRUNKS), guess, deviation)
    assert found is not None
    assert np.abs(found.pose[1:]).max() < 0.05
    assert np.linalg.inv(found.information)[0, 0] > 0.3**2


def loops_off_m(segments: Array, true: Array, drift_m: float) -> tuple[Array, Array]:
    """Return how far each loop is off along the corridor, `(N,)`, and the standard deviations of that.

    The second half of the map is off along the corridor, and the graph is sure that it is not.
    """
    keys = KeySweeps()
    closer = LoopCloser(keys)
    for number, place in enumerate(true):
        pose = compose(keys.poses[-1], relative(true[number - 1], place)) if number else place.copy()
        pose[0] += drift_m if number == len(true) // 2 else 0.0
        key = keys.add(swept(place, segments, NO_TRUNKS), pose)
        if key:
            step = relative(keys.poses[key - 1], keys.poses[key])
            keys.graph.add_edge(key - 1, key, step, np.diag([2500.0, 2500.0, 40000.0]))
        closer.look()
    state = keys.graph.state()
    loops = np.asarray(state["closes_loop"], bool)
    there = true[state["ends"][loops]]
    off_m = (relative(there[:, 0], there[:, 1]) - state["measured"][loops])[:, 0]
    return off_m, np.sqrt(np.linalg.inv(state["information"][loops] + 1e-3 * np.eye(3))[:, 0, 0])


ONWARD = np.column_stack([np.arange(-6.0, 8.0, 0.5), np.zeros(28), np.zeros(28)])
BACK = np.column_stack([ONWARD[::-1, :2], np.full(28, np.pi)])


@pytest.mark.parametrize(("width_m", "depth_m"), [(0.8, 0.3), (1.2, 0.5)])
def test_drift_is_not_confirmed_where_there_are_few_marks(width_m: float, depth_m: float) -> None:
    """The control of the one below."""
    marked = corridor(np.arange(-25, 30, 10), width_m, depth_m)
    off_m, deviations_m = loops_off_m(marked, np.concatenate([ONWARD, ONWARD]), drift_m=0.4)
    assert len(off_m) > 10
    assert (np.abs(off_m) < 3 * deviations_m).all()


def test_loops_do_not_slide_along_a_bare_corridor_on_the_way_back() -> None:
    """They slid by a metre to where more of the scan overlaps the map, against a map that was sure."""
    off_m, _ = loops_off_m(corridor(), np.concatenate([ONWARD, BACK]), drift_m=0.0)
    assert len(off_m) > 5
    assert np.abs(off_m).max() < 0.2
