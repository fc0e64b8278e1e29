"""A place is recognised far away on the map, and a loop that others contradict is taken back."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from robbie_robots.workers.mapping.grid_mapper import GridMapper
from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.loop_closing import LoopCloser
from robbie_robots.workers.mapping.place_index import PlaceIndex
from robbie_robots.workers.mapping.pose_graph import PoseGraph
from robbie_robots.workers.planar_pose import compose, relative
from tests.workers._support.synthetic_room import Drive
from tests.workers.mapping.test_gaps import swept
from tools.trials.driving.worlds import WorldConditions, false_loops, logged

CERTAIN = np.diag([1e4, 1e4, 1e5])
BUILDING = WorldConditions(
    way_m=420.0,
    bare=0.2,
    yards=0.2,
    people=0,
    glass=0.0,
    slips=0,
    lifts=0,
    drift=0.02,
    has_gyroscope=True,
    sweep_s=0.8,
    view_rad=np.radians(270),
    range_m=20.0,
    speed_m_s=1.0,
)


@pytest.mark.slow
@pytest.mark.timeout(150)
def test_loop_is_closed_though_the_map_is_60_m_off() -> None:
    log = logged(BUILDING, seed=1)
    middle = int(0.4 * len(log.odometry))
    jumped = compose(log.odometry[middle, 1:], [60.0, 20.0, 1.0])
    mapper, stamps, waiting = GridMapper(max_range_m=20.0), log.odometry[:, 0], list(log.sweeps)
    for number, (stamp, *pose) in enumerate(log.odometry.tolist()):
        has_jumped = number >= middle
        onward = relative(log.odometry[middle, 1:], pose)
        mapper.add_odometry(stamp, compose(jumped, onward) if has_jumped else pose)
        while waiting and waiting[0][0] <= stamp:
            at, sweep = waiting.pop(0)
            if not stamps[middle] - 1 <= at <= stamps[middle] + 6:
                mapper.add_scan(at, sweep)
        if number == len(stamps) // 2:
            off = relative(compose(log.true[0, 1:], mapper.pose), log.true[number, 1:])
            assert np.hypot(*off[:2]) > 50
    off = relative(compose(log.true[0, 1:], mapper.pose), log.true[-1, 1:])
    assert np.hypot(*off[:2]) < 2
    assert (mapper.gaps_open, false_loops(mapper, log.true)) == (1, 0)


def mapped_room() -> KeySweeps:
    """Two laps round the pillar of a room, in which no loop was looked for."""
    drive, keys = Drive.around_the_pillar(36.0), KeySweeps()
    for number in range(0, len(drive.true), 25):
        keys.add(swept(drive.true[number, 1:], number), drive.true[number, 1:])
    return keys


def test_place_looks_like_itself_a_lap_before_and_says_how_far_it_is_turned() -> None:
    keys = mapped_room()
    sweeps, poses = keys.sweeps, keys.poses
    growing = KeySweeps()
    index, place = PlaceIndex(growing), None
    for sweep, pose in zip(sweeps, poses, strict=True):
        growing.add(sweep, pose)
        place = index.look() or place
    assert place is not None
    restored = PlaceIndex(growing)
    restored.restore(deepcopy(index.state()))
    early = growing.travelled_m < growing.travelled_m[place] - 8.0
    found = index.alike(early, 2)
    assert restored.alike(early, 2) == found
    old, turn_rad = found[0]
    off = relative(poses[old], poses[place])
    assert np.hypot(*off[:2]) < 2.5
    assert abs(np.angle(np.exp(1j * (off[2] - turn_rad)))) < 0.3


def test_places_whose_sweeps_were_thinned_to_one_become_one() -> None:
    """Otherwise a robot that drives for days in one room would describe it again and again."""
    keys = KeySweeps()
    index = PlaceIndex(keys)
    mapped = mapped_room()
    for sweep, pose in zip(mapped.sweeps, mapped.poses, strict=True):
        keys.add(sweep, pose)
        index.look()
    assert len(index.state()["numbers"]) > 3
    index.renumber(np.arange(len(keys)) // len(keys))
    assert index.state()["numbers"].tolist() == [0]


def test_loop_that_the_others_contradict_is_taken_back() -> None:
    graph = PoseGraph()
    for number in range(20):
        graph.add_pose((0.5 * number, 0.0, 0.0))
        if number:
            graph.add_edge(number - 1, number, (0.5, 0, 0), CERTAIN)
    graph.add_edge(0, 18, (0, 3, 0), CERTAIN, closes_loop=True)
    for number in range(5):
        graph.add_edge(number, 19 - number, (9.5 - number, 0, 0), CERTAIN, closes_loop=True)
    graph.optimise()
    assert graph.drop_contradicted() == 1
    assert len(graph.state()["ends"]) == 24
    graph.optimise()
    assert graph.poses[-1] == pytest.approx([9.5, 0, 0], abs=0.3)
    assert graph.drop_contradicted() == 0


@pytest.mark.parametrize("is_known", [True, False])
def test_corridor_like_one_before_is_the_same_only_if_the_way_there_is_uncertain(is_known: bool) -> None:
    """A few places in a row that look alike are no evidence against a map that knows better."""
    log, keys = logged(replace(BUILDING, way_m=32.0, bare=0.0), seed=3), KeySweeps()
    closer, middle = LoopCloser(keys), len(log.sweeps)
    first = np.array([log.true[np.searchsorted(log.true[:, 0], at), 1:] for at, _ in log.sweeps])
    poses = np.concatenate([first, compose([9.0, 9.0, 0.0], first)[: int(0.7 * middle)]])
    for number, pose in enumerate(poses):
        keys.add(log.sweeps[number % middle][1], pose)
        if number:
            information = np.diag([0.01, 0.01, 1.0]) if number == middle and not is_known else CERTAIN
            keys.graph.add_edge(number - 1, number, relative(poses[number - 1], pose), information)
        closer.look()
    off = np.hypot(*(keys.poses[middle + 9] - keys.poses[9])[:2])
    assert off == pytest.approx(np.hypot(9.0, 9.0) if is_known else 0.0, abs=0.2)
    assert closer.closed == 0 if is_known else closer.closed >= 4


def test_pose_is_known_from_another_as_well_as_the_edges_between_them_say() -> None:
    graph = PoseGraph()
    for number in range(5):
        graph.add_pose((0.0, 2.0 * number, np.pi / 2))
        if number:
            graph.add_edge(number - 1, number, (2, 0, 0), np.diag([100.0, 400.0, 1e4]))
    along, across, turned = np.sqrt(np.diag(graph.covariance_between(1, 4)))
    assert along == pytest.approx(0.1 * np.sqrt(3))
    assert across == pytest.approx(np.sqrt(3 * 0.05**2 + (4**2 + 2**2) * 0.01**2))
    assert turned == pytest.approx(0.01 * np.sqrt(3))
    assert np.sqrt(np.diag(graph.covariance_between(0, 1))) == pytest.approx([0.1, 0.05, 0.01])
