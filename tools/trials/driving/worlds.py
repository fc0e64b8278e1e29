"""Maps many kinds of generated world from logs with truth, and compares the map with its odometry.

    python -m tools.trials worlds [--seeds N] [--first SEED] [--kinds KIND ...]

A world is a net of corridors of 30 to 120 m, some bare and some with doorways, which join halls and yards. A
kind exaggerates one trouble: bare corridors of up to 200 m, yards out of the laser's sight, crowds, glass,
slips of odometry, lifts, sweeps that come every 3 s, halls with rows of equal pillars and a laser that seldom
sweeps, a long way with good odometry, the same with a laser up to 1.5 degrees askew, or a cheap laser with
beams 0.7 to 4 degrees apart instead of one. All else is random: sweeps each 0.025 to 3 s, 90 to 360 degrees,
4 to 80 m, odometry that errs by 0.5 to 30 %, with or without a gyroscope.

The figure is the mean absolute translational error of relations, as on public logs (`slam_metric`): from 1 to
100 m of way apart, and between places visited again. A ratio is the map's error to that of its odometry.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.grid_mapper import GridMapper
from robbie_robots.workers.mapping.slam_metric import measure
from robbie_robots.workers.planar_pose import compose, relative, wrap_angle
from tools.trials.driving.campus import drive
from tools.trials.harness import Case, TrialSubject, names_of

TURN_RAD_S = 0.5
ODOMETRY_S = 0.1
MOST_SWEEPS, LEAST_WAY_M = 400, 25.0
RANGE_NOISE_M = 0.015
GLASS_SEEN_RAD = np.radians(12)  # a beam that meets glass more askew goes through
FAR_AWAY = np.array([[1e6, 0.0, 1e6, 1.0]])  # a wall, so that an arena has one
MOST_RATIO = 1.1
NOTICED_S = 5.0
GOOD_MEDIAN = 0.3
KINDS = (
    "any",
    "corridors",
    "yards",
    "crowd",
    "glass",
    "slips",
    "lifts",
    "rare sweeps",
    "long way",
    "halls",
    "askew laser",
    "coarse laser",
)
FALSE_LOOP_M = 1.0

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WorldConditions:
    """What a world, its robot and its laser are like.

    Attributes:
        way_m: Length of the drive.
        bare: Share of the corridors without doorways.
        yards: Share of the crossings that are yards of 30 to 80 m; as many are halls.
        people: People who walk around the robot.
        glass: Share of the walls that are of glass.
        slips: Times that odometry reports 1 m and 10 degrees that were not driven.
        lifts: Times that the robot is carried on some metres, and odometry is not told. In half of the
            worlds, laser and odometry are silent until it stands; in the others, the laser sees the way.
        drift: Odometry's error, as a share of the way.
        has_gyroscope: Odometry's headings err only by a tenth of that.
        sweep_s: Time from sweep to sweep.
        view_rad: Field of view.
        range_m: Farthest return.
        speed_m_s: The robot's speed.
        longest_m: Length of the longest corridors.
        is_regular: Doorways and pillars are all alike, and equally far apart.
        askew_rad: Angle by which the laser is mounted farther to the left than the mapper is given.
        beam_rad: Angle from one beam to the next.
    """

    way_m: float
    bare: float
    yards: float
    people: int
    glass: float
    slips: int
    lifts: int
    drift: float
    has_gyroscope: bool
    sweep_s: float
    view_rad: float
    range_m: float
    speed_m_s: float
    longest_m: float = 120.0
    is_regular: bool = False
    askew_rad: float = 0.0
    beam_rad: float = float(np.radians(1.0))

    @staticmethod
    def drawn(kind: str, random: np.random.Generator) -> "WorldConditions":
        """Draw the conditions of a kind."""

        def between(low: float, high: float) -> float:
            return float(np.exp(random.uniform(np.log(low), np.log(high))))

        sweep_s, speed_m_s = between(0.025, 3.0), float(random.uniform(0.4, 1.2))
        drawn = WorldConditions(
            way_m=max(LEAST_WAY_M, min(between(80.0, 400.0), MOST_SWEEPS * sweep_s * speed_m_s)),
            bare=random.uniform(0.2, 0.6),
            yards=random.uniform(0.1, 0.3),
            people=0,
            glass=0.0,
            slips=0,
            lifts=0,
            drift=between(0.005, 0.3),
            has_gyroscope=bool(random.random() < 0.4),
            sweep_s=sweep_s,
            view_rad=float(np.radians(random.choice([90, 120, 180, 240, 270, 360]))),
            range_m=between(4.0, 80.0),
            speed_m_s=speed_m_s,
        )
        long_way = {
            "way_m": 800.0,
            "sweep_s": 2.8,
            "speed_m_s": 0.8,
            "view_rad": np.pi,
            "range_m": 80.0,
            "drift": 0.01,
            "has_gyroscope": True,
        }
        changes: dict[str, dict[str, Any]] = {
            "corridors": {"bare": 0.9, "yards": 0.0, "longest_m": 200.0},
            "yards": {"yards": 0.5},
            "crowd": {"people": 12},
            "glass": {"glass": 0.3},
            "slips": {"slips": 2},
            "lifts": {"lifts": 2},
            "rare sweeps": {"sweep_s": between(1.5, 3.0), "way_m": between(150.0, 450.0)},
            "long way": long_way,
            "halls": {
                "yards": 0.5,
                "is_regular": True,
                "way_m": 400.0,
                "sweep_s": between(2.0, 3.0),
                "speed_m_s": 0.8,
                "view_rad": np.pi,
                "range_m": 80.0,
                "drift": between(0.005, 0.05),
            },
            "askew laser": {**long_way, "askew_rad": float(np.radians(random.uniform(-1.5, 1.5)))},
            "coarse laser": {
                "beam_rad": float(np.radians(between(0.7, 4.0))),
                "view_rad": 2 * np.pi,
                "range_m": between(4.0, 12.0),
                "sweep_s": between(0.1, 0.2),
            },
        }
        return replace(drawn, **changes.get(kind, {}))


class World:
    """A net of corridors, halls and yards.

    Attributes:
        arena: Its walls and pillars.
        is_glass: Which of the arena's segments are of glass.
    """

    def __init__(self, conditions: WorldConditions, random: np.random.Generator) -> None:
        self._random = random
        side = int(np.clip(np.ceil(np.sqrt(conditions.way_m / 120)), 2, 5))
        longest_m = conditions.longest_m
        longest_m = longest_m if longest_m > 120.0 else min(longest_m, 45.0 + conditions.way_m / 8)
        apart = random.uniform(35.0, longest_m, (2, side - 1))
        self._at = np.concatenate([np.zeros((2, 1)), np.cumsum(apart, axis=1)], axis=1)
        self._side = side
        free: list[list[float]] = []
        pillars: list[list[float]] = []
        for node in range(side * side):
            self._crossing(self._place(node), conditions, free, pillars)
        for one, other in self.edges():
            self._corridor(self._place(one), self._place(other), conditions, free)
        segments = _outline(np.array(free))
        boxes = box_segments(np.array(pillars).reshape(-1, 4))
        self.is_glass = np.zeros(len(segments) + len(boxes), bool)
        self.is_glass[: len(segments)] = random.random(len(segments)) < conditions.glass
        extent = self._at[:, -1] + 100
        everything = np.concatenate([segments, boxes])
        self.arena = Arena(everything, np.empty((0, 3)), Pose(0, 0, 0), float(extent[0]), float(extent[1]))

    def edges(self) -> list[tuple[int, int]]:
        """Return the pairs of crossings that a corridor joins."""
        side = self._side
        right = [(node, node + 1) for node in range(side * side) if (node + 1) % side]
        return right + [(node, node + side) for node in range(side * (side - 1))]

    def course(self, way_m: float) -> Array:
        """Return a walk along the corridors, `(N, 2)`, that prefers new ones, cut after this way."""
        new = {frozenset(edge) for edge in self.edges()}
        here, points, left_m, before = 0, [self._place(0)], way_m, -1
        while left_m > 0:
            nexts = [self._other(edge, here) for edge in self.edges() if here in edge]
            fresh = [node for node in nexts if frozenset((here, node)) in new]
            onward = fresh or [node for node in nexts if node != before] or nexts
            there = int(self._random.choice(onward))
            new.discard(frozenset((here, there)))
            leg = self._place(there) - points[-1]
            length = float(np.hypot(*leg))
            points.append(points[-1] + leg * min(1.0, left_m / length))
            left_m -= length
            here, before = there, here
        return np.array(points)

    def _other(self, edge: tuple[int, int], node: int) -> int:
        return edge[0] if edge[1] == node else edge[1]

    def _place(self, node: int) -> Array:
        return np.array([self._at[0, node % self._side], self._at[1, node // self._side]])

    def _crossing(
        self, at: Array, conditions: WorldConditions, free: list[list[float]], pillars: list[list[float]]
    ) -> None:
        kind, random, yards = self._random.random(), self._random, conditions.yards
        low, high = (15.0, 17.0) if kind < yards else (4.0, 9.0) if kind < 2 * yards else (1.2, 2.0)
        half = random.uniform(low, high, (2, 2))
        free.append([*(at - half[0]), *(at + half[1])])
        if kind >= 2 * yards:
            return
        if conditions.is_regular:
            rows = [
                np.arange(-0.8 * half[0, axis], half[1, axis], random.uniform(3.0, 6.0)) for axis in (0, 1)
            ]
            offsets, sizes = np.stack(np.meshgrid(*rows), axis=-1).reshape(-1, 2), random.uniform(0.1, 0.4, 2)
        else:
            count = int(random.integers(0, 6))
            offsets, sizes = (
                random.uniform(-0.8, 0.8, (count, 2)) * half[0],
                random.uniform(0.2, 1.0, (count, 2)),
            )
        beside = np.abs(offsets).min(axis=1) > 2.2  # the ways
        pillars += np.column_stack([at + offsets - sizes, at + offsets + sizes])[beside].tolist()

    def _corridor(
        self, begin: Array, end: Array, conditions: WorldConditions, free: list[list[float]]
    ) -> None:
        half, random = self._random.uniform(0.9, 1.8), self._random
        free.append([*(np.minimum(begin, end) - half), *(np.maximum(begin, end) + half)])
        if random.random() < conditions.bare:
            return
        along = int(end[1] > begin[1])
        at = begin[along] + random.uniform(3.0, 8.0)
        doorway = _doorway(random)
        while at < end[along] - 4.0:
            width, depth, side, apart = doorway if conditions.is_regular else _doorway(random)
            span, reach = [at, at + width], sorted([side * half, side * (half + depth)])
            across = [begin[1 - along] + offset for offset in reach]
            low_high = (span, across) if along == 0 else (across, span)
            free.append([low_high[0][0], low_high[1][0], low_high[0][1], low_high[1][1]])
            at += width + apart


def _doorway(random: np.random.Generator) -> tuple[float, float, int, float]:
    """Draw a doorway's width and depth, m, its side, and how far it is to the next one, m."""
    width, depth = random.uniform(0.8, 2.0), random.uniform(0.15, 3.0)
    return width, depth, int(random.choice([-1, 1])), random.uniform(1.0, 12.0)


def _outline(free: Array) -> Array:
    """Return the walls `(N, 4)` around the union of free rectangles `(M, 4)`."""
    xs, ys = np.unique(free[:, [0, 2]]), np.unique(free[:, [1, 3]])
    inside = np.zeros((len(xs) + 1, len(ys) + 1), bool)  # cell (i, j) begins at xs[i - 1], ys[j - 1]
    for x1, y1, x2, y2 in free:
        begin_x, end_x = np.searchsorted(xs, [x1, x2]) + 1
        begin_y, end_y = np.searchsorted(ys, [y1, y2]) + 1
        inside[begin_x:end_x, begin_y:end_y] = True
    walls = [
        [xs[i], *span[:1], xs[i], *span[1:]] for i, span in _spans(np.diff(inside.astype(int), axis=0), ys)
    ]
    walls += [
        [*span[:1], ys[j], *span[1:], ys[j]] for j, span in _spans(np.diff(inside.astype(int), axis=1).T, xs)
    ]
    return np.array(walls, float)


def _spans(changes: NDArray[np.int64], at: Array) -> Iterator[tuple[int, list[float]]]:
    """Yield the row and the ends of each run of the same change along a row."""
    for row, line in enumerate(changes):
        bounds = np.flatnonzero(np.diff(line, prepend=0, append=0))
        for begin, end in pairwise(bounds):
            if line[begin]:
                yield row, [at[begin - 1], at[end - 1]]


@dataclass(frozen=True)
class WorldLog:
    """A drive through a world.

    Attributes:
        true: `(M, 4)`: stamp (s), x, y (m), heading (rad) at each odometry message.
        odometry: `(M, 4)`, the same as odometry gives it.
        sweeps: The stamp (s) of each sweep, and the sweep.
        troubles_s: Beginning and end of each slip of odometry, and of each lift.
    """

    true: Array
    odometry: Array
    sweeps: list[tuple[float, LaserSweep]]
    troubles_s: list[tuple[float, float]]


def logged(conditions: WorldConditions, seed: int) -> WorldLog:
    """Drive through the world of a seed."""
    random = np.random.default_rng((seed, 41))
    world = World(conditions, random)
    period_s = min(ODOMETRY_S, conditions.sweep_s)
    speed = conditions.speed_m_s
    poses = np.array(list(drive(world.course(conditions.way_m), period_s, speed, TURN_RAD_S)))
    stamps = period_s * np.arange(len(poses))
    troubles = np.sort(
        random.choice(np.arange(len(poses) // 6, len(poses) - 2), conditions.slips + conditions.lifts)
    )
    is_carried, ends = np.zeros(len(poses), bool), troubles.copy()
    for number, at in enumerate(troubles if conditions.lifts else []):
        ends[number] = min(at + int(random.uniform(1.0, 5.0) / speed / period_s), len(poses) - 1)
        is_carried[at : ends[number]] = True
    kept = ~is_carried if random.random() < 0.5 else np.ones(len(poses), bool)
    steps = _measured(relative(poses[:-1], poses[1:]), conditions, random)
    steps[is_carried[1:]] = 0.0
    for at in troubles if conditions.slips else []:
        bearing = random.uniform(-np.pi, np.pi)
        steps[at] += [np.cos(bearing), np.sin(bearing), np.radians(random.choice([-10, 10]))]
    odometry = [np.zeros(3)]
    for step in steps:
        odometry.append(compose(odometry[-1], step))
    crowd = _Crowd(conditions.people, random)
    every = max(1, round(conditions.sweep_s / period_s))
    sweeps = []
    for number in range(0, len(poses), every):
        if kept[number]:
            sweep = _swept(world, conditions, poses[number], crowd.at(stamps[number], poses[number]), random)
            sweeps.append((float(stamps[number]), sweep))
    return WorldLog(
        np.column_stack([stamps, poses])[kept],
        np.column_stack([stamps, np.array(odometry)])[kept],
        sweeps,
        list(zip(stamps[troubles].tolist(), stamps[ends].tolist(), strict=True)),
    )


def _measured(steps: Array, conditions: WorldConditions, random: np.random.Generator) -> Array:
    """Return the true steps as odometry measures them: off in scale, turns, and heading with the way."""
    drift, turning = conditions.drift, conditions.drift * (0.1 if conditions.has_gyroscope else 1.0)
    way = np.hypot(steps[:, 0], steps[:, 1])
    measured = steps * [1 + drift * random.uniform(-0.5, 0.5), 1.0, 1 + turning * random.uniform(-0.5, 0.5)]
    noise = random.standard_normal(steps.shape)
    measured[:, 0] += 0.3 * drift * np.sqrt(way) * noise[:, 0]
    measured[:, 1] += 0.1 * drift * np.sqrt(way) * noise[:, 1]
    measured[:, 2] += turning * (
        0.02 * random.standard_normal() * way + 0.05 * np.sqrt(way + 0.2 * np.abs(steps[:, 2])) * noise[:, 2]
    )
    return np.asarray(measured)


class _Crowd:
    """People who walk in all directions, always some of them near the robot."""

    def __init__(self, people: int, random: np.random.Generator) -> None:
        self._offset = random.uniform(-6.0, 6.0, (people, 2))
        self._velocity = random.uniform(-1.2, 1.2, (people, 2))

    def at(self, now_s: float, robot: Array) -> Array:
        """Return the people as circles `(N, 3)`: x, y, radius, m."""
        places = self._offset + self._velocity * now_s
        near = (places - robot[:2] + 6.0) % 12.0 - 6.0 + robot[:2]  # who leaves comes back on the other side
        near = near[np.hypot(*(near - robot[:2]).T) > 0.5]
        return np.column_stack([near, np.full(len(near), 0.15)])


def _swept(
    world: World, conditions: WorldConditions, pose: Array, people: Array, random: np.random.Generator
) -> LaserSweep:
    beams = 1 + round(conditions.view_rad / conditions.beam_rad)
    bearings = np.linspace(-conditions.view_rad / 2, conditions.view_rad / 2, beams)
    segments, reach = world.arena.segments, conditions.range_m
    low, high = np.minimum(segments[:, :2], segments[:, 2:]), np.maximum(segments[:, :2], segments[:, 2:])
    near = ((low < pose[:2] + reach) & (high > pose[:2] - reach)).all(axis=1)
    is_glass = np.append(world.is_glass[near], False)
    walls = np.append(segments[near], FAR_AWAY, axis=0)
    arena = replace(world.arena, segments=walls, circles=people)
    facing_rad = bearings + pose[2] + conditions.askew_rad
    eye = (float(pose[0]), float(pose[1]), facing_rad)
    ranges, hit = arena.hits(*eye)
    if is_glass.any():
        along = np.diff(walls.reshape(-1, 2, 2), axis=1)[:, 0]
        facing = np.arctan2(along[:, 1], along[:, 0])[np.minimum(hit, len(is_glass) - 1)] - facing_rad
        glass = np.append(is_glass, np.zeros(len(people), bool))[hit]
        through = glass & (np.abs(np.cos(facing)) > np.sin(GLASS_SEEN_RAD))
        behind = replace(arena, segments=walls[~is_glass]).ranges_m(*eye)
        ranges = np.where(through, behind, ranges)
    ranges = ranges + RANGE_NOISE_M * random.standard_normal(beams)
    return LaserSweep.from_ranges(ranges, bearings[0], bearings[1] - bearings[0], 0.05, reach)


@dataclass(frozen=True)
class WorldResult:
    """The result in one world: errors of the map and of its odometry, m, and what mapping said.

    Attributes:
        error_m: Mean absolute translational error of the relations, in the map's trajectory.
        odometry_m: The same for odometry.
        ratio: Their quotient.
        untold: Slips and lifts that mapping did not report within 5 s.
        alarms: Slips that mapping reported where there were none. A gap may be one: the laser saw too little.
    """

    seed: int
    kind: str
    error_m: float
    odometry_m: float
    ratio: float
    loops: int
    false_loops: int
    slips: int
    gaps: int
    gaps_open: int
    troubles: int
    untold: int
    alarms: int
    key_sweeps: int
    sweeps: int
    times_real_time: float
    conditions: WorldConditions


def trial(kind: str, seed: int, change: dict[str, Any] | None = None) -> WorldResult:
    """Map the world of a kind and a seed."""
    conditions = WorldConditions.drawn(kind, np.random.default_rng((seed, KINDS.index(kind))))
    conditions = replace(conditions, **(change or {}))
    log = logged(conditions, seed)
    mapper = GridMapper(max_range_m=conditions.range_m)
    busy_s, told_s, slipped_s, before, at = 0.0, [], [], 0, 0
    for stamp, *pose in log.odometry.tolist():
        began_s, slips = time.process_time(), mapper.slips_noticed
        mapper.add_odometry(stamp, pose)
        while at < len(log.sweeps) and log.sweeps[at][0] <= stamp:
            mapper.add_scan(*log.sweeps[at])
            at += 1
        busy_s += time.process_time() - began_s
        doubts = mapper.slips_noticed + mapper.gaps_noticed
        if doubts > before or not mapper.is_certain:
            told_s.append(stamp)
        slipped_s += [stamp] * (mapper.slips_noticed - slips)
        before = doubts
    path = mapper.trajectory()
    facing = log.true.copy()  # where a map that this laser makes sees the robot
    facing[:, 3] += conditions.askew_rad
    error, by_odometry = (
        measure(one, _relations(true, np.random.default_rng(seed))).translation_mean_m
        for one, true in ((path, facing), (log.odometry, log.true))
    )
    # What happens between two sweeps can only be told at the next one.
    troubles_s = [(begin, end + NOTICED_S + conditions.sweep_s) for begin, end in log.troubles_s]
    return WorldResult(
        seed=seed,
        kind=kind,
        error_m=round(error, 4),
        odometry_m=round(by_odometry, 4),
        ratio=round(error / by_odometry, 3),
        loops=mapper.loops_closed,
        false_loops=false_loops(mapper, facing),
        slips=mapper.slips_noticed,
        gaps=mapper.gaps_noticed,
        gaps_open=mapper.gaps_open,
        troubles=len(log.troubles_s),
        untold=sum(not any(begin <= at <= end for at in told_s) for begin, end in troubles_s),
        alarms=sum(not any(begin <= at <= end for begin, end in troubles_s) for at in slipped_s),
        key_sweeps=mapper.key_sweeps,
        sweeps=len(log.sweeps),
        times_real_time=round(float(log.true[-1, 0]) / busy_s, 1),
        conditions=conditions,
    )


def _relations(true: Array, random: np.random.Generator, most: int = 1500) -> Array:
    """Draw relations `(R, 8)` from the truth: some way apart, and where the robot was before."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(true[:, 1:3], axis=0).T))])
    firsts = np.searchsorted(way, random.uniform(0, way[-1], most))
    seconds = np.searchsorted(way, way[firsts] + np.exp(random.uniform(0, np.log(100), most)))
    again = [
        np.flatnonzero((np.hypot(*(true[:, 1:3] - true[one, 1:3]).T) < 3) & (way > way[one] + 20))
        for one in firsts
    ]
    visited = [(one, random.choice(others)) for one, others in zip(firsts, again, strict=True) if len(others)]
    pairs = np.array([*zip(firsts, seconds, strict=True), *visited])
    pairs = pairs[(pairs < len(true)).all(axis=1)]
    one, other = true[pairs[:, 0]], true[pairs[:, 1]]
    step = relative(one[:, 1:], other[:, 1:])
    flat = np.zeros(len(pairs))
    return np.column_stack([one[:, 0], other[:, 0], step[:, :2], flat, flat, flat, step[:, 2]])


def false_loops(mapper: GridMapper, true: Array) -> int:
    """Return how many loops of the finished map, which was not thinned, are false.

    A false loop would move a pose that is known within 1 m by more than that. So a loop in a bare corridor
    may be off along it, if it does not claim to know.
    """
    state = mapper.state()
    graph, anchors = state["keys"]["graph"], state["anchors"]["rows"]
    loops = np.asarray(graph["closes_loop"], bool)
    if not loops.any():
        return 0
    taken = anchors[~anchors[:, 5:8].any(axis=1)]  # each key sweep's own anchor
    odometry = state["odometry"]["rows"]
    at = np.interp(taken[:, 0], np.arange(len(odometry)), odometry[:, 0])
    truth = np.column_stack(
        [np.interp(at, true[:, 0], column) for column in (*true[:, 1:3].T, np.unwrap(true[:, 3]))]
    )
    ends, information = graph["ends"][loops], graph["information"][loops]
    off = relative(truth[ends[:, 0]], truth[ends[:, 1]]) - graph["measured"][loops]
    off[:, 2] = wrap_angle(off[:, 2])
    known = np.eye(3) / FALSE_LOOP_M**2
    moved = np.linalg.solve(information + known, np.einsum("eij,ej->ei", information, off)[..., None])[..., 0]
    return int((np.hypot(moved[:, 0], moved[:, 1]) > FALSE_LOOP_M).sum())


def summary(results: list[WorldResult]) -> dict[str, Any]:
    """Return how the maps compare with their odometry."""
    ratios = np.array([one.ratio for one in results])
    return {
        "worlds": len(results),
        f"worse than {MOST_RATIO} x odometry": int((ratios > MOST_RATIO).sum()),
        "median ratio": round(float(np.median(ratios)), 3),
        "worst ratio": float(ratios.max()),
        "troubles": sum(one.troubles for one in results),
        f"not told within {NOTICED_S:g} s": sum(one.untold for one in results),
        "slips told of none": sum(one.alarms for one in results),
        "false loops": sum(one.false_loops for one in results),
    }


def is_good(results: list[WorldResult]) -> bool:
    """Return whether no map is worse than its odometry, most are much better, and all troubles were told."""
    ratios = [one.ratio for one in results]
    is_told = not any(one.untold or one.false_loops for one in results)
    return is_told and max(ratios) <= MOST_RATIO and float(np.median(ratios)) <= GOOD_MEDIAN


def kinds(chosen: argparse.Namespace) -> Sequence[str]:
    """Return the kinds to map."""
    return names_of(chosen.kinds, KINDS)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of worlds."""
    parser.add_argument("--kinds", nargs="*", default=[], metavar="KIND", help=f"of {', '.join(KINDS)} (all)")


def play(case: Case) -> WorldResult:
    """Map one world."""
    return trial(case.kind, case.seed)


SUBJECT = TrialSubject(
    play=play,
    options=options,
    kinds=kinds,
    summary=summary,
    is_good=is_good,
    results="worlds",
    seeds=20,
    seed_makes="a world of each kind",
)
