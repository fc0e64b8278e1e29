"""Measures how mapping copes with slips: odometry that suddenly reports a motion which did not happen.

In random buildings, a simulated robot maps while it drives from place to place, with a laser of 180 beams at
5 Hz. From time to time its odometry jumps by 1 m and 10 degrees. A slip counts as noticed when the mapper
says so, and as undone when its pose is right again and remains right until the next slip.

    python -m tools.trials slips [--seeds N] [--slips N]
"""

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.hw.simulation.random_rooms import drawn_map, random_rooms
from robbie_robots.workers.mapping.grid_mapper import GridMapper
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.planar_pose import compose, relative, wrap_angle
from tools.trials.driving.localization import CLEARANCE_M, RESOLUTION_M, STEP_S, Conditions, Operator
from tools.trials.driving.swept import swept
from tools.trials.harness import TrialSubject

SLIP_M, SLIP_RAD = 1.0, math.radians(10)
BEFORE_M, AFTER_M = 15.0, 6.0  # driven before the first slip, and after each
NOTICED_M = 3.0  # a slip must be noticed and undone within this distance
RIGHT_M, RIGHT_RAD = 0.25, 0.1
STEPS_PER_SWEEP = 2


@dataclass(frozen=True)
class Slip:
    """The result of one slip.

    Attributes:
        seed: Random seed of the building.
        number: Number of the slip in this building.
        noticed_m: Distance driven until the mapper noticed it; None if it did not within 3 m.
        undone_m: Distance driven until the pose was right and remained so; None if that took over 3 m.
        unwarned_m: Largest error of a pose that the mapper gave as certain.
        end_error_m: Error of the pose at the end of the stretch.
    """

    seed: int
    number: int
    noticed_m: float | None
    undone_m: float | None
    unwarned_m: float
    end_error_m: float

    @property
    def is_good(self) -> bool:
        """Whether the slip was noticed and undone in time."""
        return self.noticed_m is not None and self.undone_m is not None


class SlippingDrive:
    """A robot in a random building, whose odometry slips on demand, and its mapper; in simulated time."""

    def __init__(self, seed: int) -> None:
        conditions = Conditions(view_deg=180.0)
        self.now_s, self.way_m, self.busy_s = 0.0, 0.0, 0.0
        arena = random_rooms(seed, conditions.width_m, conditions.height_m)
        cells, corner = drawn_map(arena, RESOLUTION_M)
        self._laser = SimulatedLaser(arena, conditions.laser(), seed=seed)
        self._operator = Operator(NavigationGrid(cells, RESOLUTION_M, corner, CLEARANCE_M), seed)
        self._drive = SimulatedDrive(arena, lambda: self.now_s, seed)
        self._start = self._drive.ground_truth().pose
        self._wheels = self._drive.read().pose  # as read last
        self._odometry: NDArray[np.float64] = np.zeros(3)  # as the mapper gets it
        self._steps = 0
        self.mapper = GridMapper()
        self.true: list[Pose] = []

    def slip(self, step: NDArray[np.float64]) -> None:
        """Have odometry report a motion (x m, y m, heading rad) that does not happen."""
        self._odometry = compose(self._odometry, step)

    def error(self) -> tuple[float, float]:
        """Return the error of the mapper's pose now: m, rad."""
        return off(compose(self._start, self.mapper.pose), np.array(self.true[-1], float))

    def steps(self, way_m: float) -> Iterator[None]:
        """Drive a distance; yield after each sweep."""
        end_m = self.way_m + way_m
        while self.way_m < end_m:
            truth, wheels = self._drive.ground_truth(), self._drive.read()
            self._odometry = compose(self._odometry, relative(self._wheels, wheels.pose))
            self._wheels = wheels.pose
            self.true.append(truth.pose)
            self._laser.place(truth.pose, truth.stamp_s)
            sweep = swept(self._laser)
            began_s = time.process_time()
            self.mapper.add_odometry(self.now_s, self._odometry)
            if self._steps % STEPS_PER_SWEEP == 0:
                self.mapper.add_scan(self.now_s, sweep)
            self.busy_s += time.process_time() - began_s
            if self._steps % STEPS_PER_SWEEP == 0:
                yield
            self._steps += 1
            self._drive.command(*self._operator.speeds(truth.pose, sweep), valid_for_s=0.4)
            self.now_s += STEP_S
            self.way_m += abs(self._drive.read().linear_m_per_s) * STEP_S


def off(one: NDArray[np.float64], other: NDArray[np.float64]) -> tuple[float, float]:
    """Return how far two poses are apart: m, rad."""
    return float(np.hypot(*(one - other)[:2])), abs(float(wrap_angle(one[2] - other[2])))


def one_slip(drive: SlippingDrive, seed: int, number: int, after_m: float) -> Slip:
    """Have odometry slip, drive on, and watch the mapper."""
    random = np.random.default_rng((seed, number, 11))
    bearing, turn = random.uniform(-np.pi, np.pi), random.choice([-SLIP_RAD, SLIP_RAD])
    drive.slip(np.array([SLIP_M * np.cos(bearing), SLIP_M * np.sin(bearing), turn]))
    before, begin_m = drive.mapper.slips_noticed, drive.way_m
    noticed_m, right_since_m, unwarned_m, error_m = None, None, 0.0, 0.0
    for _ in drive.steps(after_m):
        way_m = drive.way_m - begin_m
        if noticed_m is None and drive.mapper.slips_noticed > before:
            noticed_m = way_m
        error_m, error_rad = drive.error()
        if error_m > RIGHT_M or error_rad > RIGHT_RAD:
            right_since_m = None
        elif right_since_m is None:
            right_since_m = way_m
        if drive.mapper.is_certain:
            unwarned_m = max(unwarned_m, error_m)
    return Slip(
        seed, number, _within(noticed_m), _within(right_since_m), round(unwarned_m, 3), round(error_m, 3)
    )


def _within(way_m: float | None) -> float | None:
    return round(way_m, 2) if way_m is not None and way_m <= NOTICED_M else None


@dataclass(frozen=True)
class SlipsBuilding:
    """The result in one building: its slips, and the error of the whole trajectory in the end."""

    slips: list[Slip]
    noticed: int
    false_alarms: int
    mean_error_m: float
    worst_error_m: float
    times_real_time: float


def trial(seed: int, slips: int, before_m: float = BEFORE_M, after_m: float = AFTER_M) -> SlipsBuilding:
    """Drive through one building with a number of slips."""
    drive = SlippingDrive(seed)
    for _ in drive.steps(before_m):
        pass
    false_alarms = drive.mapper.slips_noticed
    found = [one_slip(drive, seed, number, after_m) for number in range(slips)]
    path = compose(np.array(drive.true[0], float), drive.mapper.trajectory()[:, 1:])
    error = np.hypot(*(path - np.array(drive.true, float))[:, :2].T)
    return SlipsBuilding(
        found,
        drive.mapper.slips_noticed,
        false_alarms,
        round(float(error.mean()), 3),
        round(float(error.max()), 3),
        round(drive.now_s / drive.busy_s, 1),
    )


def summary(buildings: list[SlipsBuilding]) -> dict[str, int]:
    """Return how many slips were noticed and undone in time."""
    every = [slip for building in buildings for slip in building.slips]
    return {"slips": len(every), "good": sum(slip.is_good for slip in every)}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of buildings."""
    parser.add_argument("--slips", type=int, default=4, metavar="N", help="slips in each (4)")


SUBJECT = TrialSubject(
    play=lambda case: trial(case.seed, case.options.slips),
    options=options,
    summary=summary,
    is_good=lambda buildings: all(slip.is_good for building in buildings for slip in building.slips),
    results="buildings",
    seeds=5,
    seed_makes="a building",
)
