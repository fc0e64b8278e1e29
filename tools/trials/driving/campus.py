"""Maps a simulated campus of corridors, 500 m x 300 m with three loops, and measures the map.

    python -m tools.trials campus [--width M] [--height M] [--loops N] [--key-sweeps N]

The corridors are 3 m wide and have doorways of random width and depth. The robot drives around every loop
with odometry that errs by some 1 % of each distance and 2 degrees in each turn of 90, and a laser of 180
beams at 5 Hz. The tool drives the mapping worker alone, as fast as possible. It reports the error at the end
of the drive, the sweeps that are not in the map, the memory of the grid, and how many times faster than the
drive the worker was. A key sweep that the mapper removed to make room counts as not in the map.
"""

import argparse
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.grid_mapper import GridMapper, MapperLimits
from robbie_robots.workers.planar_pose import compose, relative
from tools.trials.harness import Case, TrialSubject

HALF_M = 1.5  # of a corridor's width
SPEED_M_S, TURN_RAD_S = 1.0, 0.5
SWEEP_PERIOD_S, ODOMETRY_PER_SWEEP = 0.2, 2
BEAMS, RANGE_MAX_M, RANGE_NOISE_M = 180, 30.0, 0.01
ANGLE_MIN_RAD, INCREMENT_RAD = -np.pi / 2, np.pi / 180
SCALE_ERROR, TURN_ERROR = 0.01, 2 / 90
KEY_SWEEPS = 12_000
MOST_END_ERROR_M = 0.5
LEAST_SPEED_UP = 15.0


@dataclass(frozen=True)
class CampusResult:
    """The result of one drive through a campus."""

    driven_m: float
    sweeps: int
    key_sweeps: int
    thinned: int
    refused: dict[str, int]
    loops_closed: int
    end_error_m: float
    mean_error_m: float
    odometry_end_error_m: float
    grid_megabytes: float
    peak_megabytes: float
    map_m: tuple[float, float]
    times_real_time: float

    def violations(self) -> list[str]:
        """Return what is not as it must be, except for the speed, which depends on the machine."""
        found = [f"{count} {reason}" for reason, count in self.refused.items() if count]
        if self.thinned:
            found.append(f"{self.thinned} key sweeps removed to make room")
        if self.end_error_m > MOST_END_ERROR_M:
            found.append(f"the error at the end is {self.end_error_m:.2f} m")
        return found


class Campus:
    """A row of rectangular loops of corridors that share their inner sides.

    Attributes:
        segments: `(N, 4)`: x, y of both ends of each wall, m.
    """

    def __init__(self, width_m: float, height_m: float, loops: int, seed: int) -> None:
        self.columns = np.linspace(0, width_m, loops + 1)
        self.height_m = height_m
        self._rng = np.random.default_rng(seed)
        walls: list[list[float]] = []
        for left, right in pairwise(self.columns):
            low, high = np.array([left, 0]) + HALF_M, np.array([right, height_m]) - HALF_M
            self._ring(walls, low, high, outward=-1)
        outer = np.array([width_m, height_m]) + HALF_M
        self._ring(walls, np.full(2, -HALF_M), outer, outward=1)
        self.segments = np.array(walls)

    def _ring(
        self, walls: list[list[float]], low: NDArray[np.float64], high: NDArray[np.float64], outward: int
    ) -> None:
        corners = [low, np.array([high[0], low[1]]), high, np.array([low[0], high[1]])]
        for begin, end in zip(corners, corners[1:] + corners[:1], strict=True):
            along = (end - begin) / np.hypot(*(end - begin))
            away = outward * np.array([along[1], -along[0]])
            self._wall(walls, begin, end, away)

    def _wall(
        self,
        walls: list[list[float]],
        begin: NDArray[np.float64],
        end: NDArray[np.float64],
        away: NDArray[np.float64],
    ) -> None:
        """Add a wall with doorways, which lie back from the corridor."""
        length = float(np.hypot(*(end - begin)))
        along = (end - begin) / length
        at, points = 0.0, [begin]
        while True:
            at += self._rng.uniform(3.0, 9.0)
            width, depth = self._rng.uniform(0.8, 2.0), self._rng.uniform(0.15, 1.0)
            if at + width > length - 2.0:
                break
            door = [begin + along * at, begin + along * (at + width)]
            points += [door[0], door[0] + away * depth, door[1] + away * depth, door[1]]
            at += width
        points.append(end)
        walls += [[*one, *other] for one, other in pairwise(points)]

    def course(self) -> NDArray[np.float64]:
        """Return the corners of the drive `(N, 2)`: one loop after the other, and back to the start."""
        left, right, top = self.columns[0], self.columns[1], self.height_m
        corners = [[left, 0.0], [left, top], [right, top], [right, 0], [left, 0]]
        lower = True  # which of the two long sides the robot is on
        for before, after in pairwise(self.columns[1:]):
            here, there = (0, top) if lower else (top, 0)
            corners += [[after, here], [after, there], [before, there]]
            lower = not lower
        here = corners[-1][1]
        corners += [[left, here]] if here == 0 else [[left, here], [left, 0]]
        return np.array(corners, float)

    def ranges(self, pose: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float32]:
        """Measure a sweep from a pose."""
        low = np.minimum(self.segments[:, :2], self.segments[:, 2:])
        high = np.maximum(self.segments[:, :2], self.segments[:, 2:])
        near = ((low < pose[:2] + RANGE_MAX_M) & (high > pose[:2] - RANGE_MAX_M)).all(axis=1)
        begin = self.segments[near, :2] - pose[:2]
        along = self.segments[near, 2:] - self.segments[near, :2]
        bearings = pose[2] + ANGLE_MIN_RAD + INCREMENT_RAD * np.arange(BEAMS)
        beam = np.column_stack([np.cos(bearings), np.sin(bearings)])
        cross = beam[:, :1] * along[:, 1] - beam[:, 1:] * along[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]) / cross
            share = (begin[:, 0] * beam[:, 1:] - begin[:, 1] * beam[:, :1]) / cross
            distance[~((distance > 0) & (share >= 0) & (share <= 1))] = np.inf
        measured: NDArray[np.float32] = (
            distance.min(axis=1) + RANGE_NOISE_M * rng.standard_normal(BEAMS)
        ).astype(np.float32)
        return measured


def drive(
    course: NDArray[np.float64],
    period_s: float,
    speed_m_s: float = SPEED_M_S,
    turn_rad_s: float = TURN_RAD_S,
) -> Iterator[NDArray[np.float64]]:
    """Yield the true poses of a drive along a course: straight on, and turns on the spot."""
    heading = float(np.arctan2(*(course[1] - course[0])[::-1]))
    for begin, end in pairwise(course):
        ahead = end - begin
        turn = (float(np.arctan2(ahead[1], ahead[0])) - heading + np.pi) % (2 * np.pi) - np.pi
        steps = int(np.ceil(abs(turn) / (turn_rad_s * period_s)))
        for step in range(steps):
            yield np.array([*begin, heading + turn * step / steps])
        heading += turn
        steps = int(np.ceil(np.hypot(*ahead) / (speed_m_s * period_s)))
        for step in range(steps):
            yield np.array([*(begin + ahead * step / steps), heading])
    yield np.array([*course[-1], heading])


def trial(
    width_m: float,
    height_m: float,
    loops: int,
    seed: int,
    course: NDArray[np.float64] | None = None,
    key_sweeps: int = KEY_SWEEPS,
) -> CampusResult:
    """Drive through a campus and map it."""
    campus = Campus(width_m, height_m, loops, seed)
    course = campus.course() if course is None else course
    rng = np.random.default_rng(seed + 1)
    period_s = SWEEP_PERIOD_S / ODOMETRY_PER_SWEEP
    mapper, busy_s, sweeps = GridMapper(limits=MapperLimits(key_sweeps=key_sweeps)), 0.0, 0
    scale = rng.normal(1.0, SCALE_ERROR)
    true: list[NDArray[np.float64]] = []
    odometry = np.zeros(3)
    for number, pose in enumerate(drive(course, period_s)):
        if true:
            step = relative(true[-1], pose)
            step[:2] *= scale + SCALE_ERROR * rng.standard_normal()
            step[2] *= 1 + TURN_ERROR * rng.standard_normal()
            step[2] += 0.0005 * rng.standard_normal()
            odometry = compose(odometry, step)
        true.append(pose)
        ranges = campus.ranges(pose, rng) if number % ODOMETRY_PER_SWEEP == 0 else None
        began_s = time.process_time()
        mapper.add_odometry(number * period_s, odometry)
        if ranges is not None:
            sweeps += 1
            sweep = LaserSweep.from_ranges(ranges, ANGLE_MIN_RAD, INCREMENT_RAD, 0.05, RANGE_MAX_M)
            mapper.add_scan(number * period_s, sweep)
            if sweeps % 5 == 0:
                mapper.grid(16_000_000, 1000)
        busy_s += time.process_time() - began_s
    path, grid = mapper.trajectory(), mapper.drawn()
    off = np.hypot(*(compose(true[0], path[:, 1:]) - np.array(true))[:, :2].T)
    by_odometry = compose(true[0], odometry) - true[-1]
    rows, columns = grid.known().shape
    return CampusResult(
        driven_m=round(float(np.hypot(*np.diff(np.array(true)[:, :2], axis=0).T).sum()), 1),
        sweeps=sweeps,
        key_sweeps=mapper.key_sweeps,
        thinned=mapper.thinned,
        refused={reason: count for reason, count in mapper.refused.items() if count},
        loops_closed=mapper.loops_closed,
        end_error_m=round(float(off[-1]), 3),
        mean_error_m=round(float(off.mean()), 3),
        odometry_end_error_m=round(float(np.hypot(*by_odometry[:2])), 2),
        grid_megabytes=round(grid.bytes / 1e6, 1),
        peak_megabytes=round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, 1),
        map_m=(round(columns * grid.resolution_m, 1), round(rows * grid.resolution_m, 1)),
        times_real_time=round(len(true) * period_s / busy_s, 1),
    )


def play(case: Case) -> CampusResult:
    """Map the campus of a seed."""
    chosen = case.options
    return trial(chosen.width, chosen.height, chosen.loops, case.seed, key_sweeps=chosen.key_sweeps)


def summary(results: list[CampusResult]) -> dict[str, object]:
    """Return what is not as it must be, and how often the machine was too slow to tell."""
    return {
        "violations": [text for one in results for text in one.violations()],
        f"slower_than_{LEAST_SPEED_UP:g}_times_real_time": sum(
            one.times_real_time < LEAST_SPEED_UP for one in results
        ),
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the campus."""
    parser.add_argument("--width", type=float, default=500.0, metavar="M", help="between outer corridors, m")
    parser.add_argument("--height", type=float, default=300.0, metavar="M", help="between outer corridors, m")
    parser.add_argument("--loops", type=int, default=3)
    parser.add_argument("--key-sweeps", type=int, default=KEY_SWEEPS, metavar="N", help="limit of the map")


SUBJECT = TrialSubject(
    play=play,
    options=options,
    summary=summary,
    is_good=lambda results: not any(one.violations() for one in results),
    seeds=1,
    seed_makes="a campus",
)
