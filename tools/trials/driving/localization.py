"""Measures global localization: robots that know only the map, in random buildings, over many seeds.

In each building, a simulated robot starts at a random pose and drives around. The localizer has the map of
the building and receives laser sweeps and odometry (with slip). The tool measures how far the robot has
driven when the localizer reports that it is sure, and its error from then on. It is a failure if the
localizer is sure of a wrong place. With `--kidnap`, the tool then moves the robot elsewhere and measures the
distance until the localizer finds it again.

    python -m tools.trials localization --seeds 20 [--kidnap]
"""

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.drive import SimulatedDrive, WorldState
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.hw.simulation.random_rooms import drawn_map, random_rooms
from robbie_robots.workers.laser.laser_sweep import LaserSweep, MountedSweep
from robbie_robots.workers.localization.likelihood_field import LikelihoodField
from robbie_robots.workers.localization.localizer import Localizer
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from robbie_robots.workers.navigation.path_follower import PathFollower
from robbie_robots.workers.navigation.path_planner import PathField
from robbie_robots.workers.planar_pose import wrap_angle
from tools.trials.driving.swept import swept
from tools.trials.harness import Case, TrialSubject

RESOLUTION_M = 0.05
STEP_S = 0.1
CLEARANCE_M = 0.27
RIGHT_M, RIGHT_RAD = 0.3, 0.2
ON_AFTER_M = 5.0  # driven on once the robot is sure, to see whether it stays right


@dataclass(frozen=True)
class Conditions:
    """The conditions of the trials.

    Attributes:
        width_m: Width of the building.
        height_m: Height of the building on its plan.
        range_m: Maximum range of the laser.
        view_deg: Angle over which the laser measures.
    """

    width_m: float = 14.0
    height_m: float = 10.0
    range_m: float = 10.0
    view_deg: float = 360.0

    def laser(self) -> LaserGeometry:
        """Return a laser with this range and view, and with a beam for each degree."""
        view_rad, beams = math.radians(self.view_deg), round(self.view_deg)
        return LaserGeometry(-view_rad / 2, view_rad / beams, beams, range_max_m=self.range_m)


@dataclass(frozen=True)
class LocalizationResult:
    """The result for one robot.

    Attributes:
        seed: Random seed of the building, the start and all noise.
        way_m: Distance driven until the localizer was sure; None if it never was.
        worst_m: Maximum error from then on.
        mean_m: Mean error from then on.
        recovery_m: Distance driven from the move until the robot was found again; None if it was not.
        scan_ms: Mean time for one sweep and its odometry.
        first_scan_ms: Time for the first sweep, which searches the whole map.
    """

    seed: int
    way_m: float | None
    worst_m: float | None
    mean_m: float | None
    recovery_m: float | None
    scan_ms: float
    first_scan_ms: float


class Operator:
    """Drives a robot from one random place to the next. It knows the true pose."""

    def __init__(self, grid: NavigationGrid, seed: int) -> None:
        self._grid, self._random = grid, np.random.default_rng((seed, 7))
        self._guard, self._follower = CollisionGuard(), PathFollower()
        self._blocked = 0

    def speeds(self, pose: Pose, sweep: LaserSweep) -> tuple[float, float]:
        """Return the speeds to command."""
        if self._blocked > 10 or not len(self._follower.path) or self._follower.is_arrived(pose):
            self._follower.follow(self._way(pose))
            self._blocked = 0
        wanted = self._follower.velocity(pose)
        allowed = self._guard.checked(self._guard.near_points([MountedSweep(sweep)]), wanted)
        self._blocked = self._blocked + 1 if allowed[0] == 0.0 != wanted[0] else 0
        return allowed

    def elsewhere(self) -> Pose:
        """Return a random pose where the robot can stand."""
        cells = np.argwhere(self._grid.drivable)
        xy = self._grid.middles_m(cells[self._random.integers(len(cells))])
        x_m, y_m = xy.tolist()
        return Pose(x_m, y_m, self._random.uniform(-np.pi, np.pi))

    def _way(self, pose: Pose) -> NDArray[np.float64]:
        start = self._grid.nearest(self._grid.drivable, pose, 1.0)
        assert start is not None
        ways = PathField(self._grid, start)
        reached = np.argwhere(np.isfinite(ways.cost_m))
        goal = reached[self._random.integers(len(reached))]
        return self._grid.middles_m(ways.path((int(goal[0]), int(goal[1]))))


class DrivenRobot:
    """A simulated robot with its operator and its localizer, in simulated time."""

    def __init__(self, seed: int, conditions: Conditions) -> None:
        self.now_s, self.way_m, self._seed = 0.0, 0.0, seed
        self.arena = random_rooms(seed, conditions.width_m, conditions.height_m)
        cells, corner = drawn_map(self.arena, RESOLUTION_M)
        self.localizer = Localizer(LikelihoodField(cells, RESOLUTION_M, corner), seed=seed)
        self.laser = SimulatedLaser(self.arena, conditions.laser(), seed=seed)
        self.operator = Operator(NavigationGrid(cells, RESOLUTION_M, corner, CLEARANCE_M), seed)
        self.drive = SimulatedDrive(self.arena, lambda: self.now_s, seed)
        self.busy_s: list[float] = []

    def steps(self, way_m: float) -> Iterator[Pose]:
        """Drive a distance, and yield the true pose after each sweep."""
        end_m = self.way_m + way_m
        while self.way_m < end_m:
            truth, wheels = self.drive.ground_truth(), self.drive.read()
            self.laser.place(truth.pose, truth.stamp_s)
            sweep = swept(self.laser)
            began = time.process_time()
            self.localizer.add_odometry(wheels.stamp_s, wheels.pose)
            self.localizer.add_scan(truth.stamp_s, sweep)
            self.busy_s.append(time.process_time() - began)
            yield truth.pose
            self.drive.command(*self.operator.speeds(truth.pose, sweep), valid_for_s=0.4)
            self.now_s += STEP_S
            self.way_m += abs(self.drive.read().linear_m_per_s) * STEP_S

    def lift(self) -> None:
        """Move the robot elsewhere, without any odometry of it."""
        odometry = self.drive.world_state().odometry
        world = WorldState(self.operator.elsewhere(), odometry)
        self.drive = SimulatedDrive(self.arena, lambda: self.now_s, self._seed, resumed=world)

    def way_until_sure(self, limit_m: float) -> float | None:
        """Drive until the localizer is sure. Return the distance, or None if it is not sure or is wrong."""
        begin_m, was_sure = self.way_m, self._converged
        for truth in self.steps(limit_m):
            if self._converged and self.is_right(truth):
                return self.way_m - begin_m
            if self._converged and not was_sure:
                return None
            was_sure = self._converged
        return None

    @property
    def _converged(self) -> bool:
        return self.localizer.newest is not None and self.localizer.newest.converged

    def off_m(self, truth: Pose) -> float:
        """Return the localizer's error."""
        assert self.localizer.pose is not None
        return float(np.hypot(*(self.localizer.pose[:2] - truth[:2])))

    def is_right(self, truth: Pose) -> bool:
        """Return whether the localizer's pose is right."""
        assert self.localizer.pose is not None
        turned = abs(float(wrap_angle(self.localizer.pose[2] - truth[2])))
        return self.off_m(truth) < RIGHT_M and turned < RIGHT_RAD


def run_trial(seed: int, conditions: Conditions, limit_m: float, kidnap: bool) -> LocalizationResult:
    """Run one trial."""
    drive = DrivenRobot(seed, conditions)
    way_m = drive.way_until_sure(limit_m)
    off = [drive.off_m(truth) for truth in drive.steps(ON_AFTER_M)] if way_m is not None else []
    recovery_m = None
    if kidnap and off:
        drive.lift()
        recovery_m = drive.way_until_sure(2 * limit_m)
    return LocalizationResult(
        seed,
        way_m,
        max(off, default=None),
        float(np.mean(off)) if off else None,
        recovery_m,
        1e3 * float(np.mean(drive.busy_s[1:])),
        1e3 * drive.busy_s[0],
    )


def play(case: Case) -> LocalizationResult:
    """Localize a robot in the building of a seed."""
    conditions = Conditions(*(getattr(case.options, name) for name in Conditions.__dataclass_fields__))
    return run_trial(case.seed, conditions, case.options.limit, case.options.kidnap)


def found(trials: list[LocalizationResult]) -> int:
    """Return how many robots were found, and stayed right."""
    return sum(trial.worst_m is not None and trial.worst_m < RIGHT_M for trial in trials)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of buildings."""
    limit = "maximum distance until the localizer is sure, m (20)"
    parser.add_argument("--limit", type=float, default=20.0, help=limit)
    kidnap = "move the robot elsewhere after it has been found"
    parser.add_argument("--kidnap", action="store_true", help=kidnap)
    for name, field in Conditions.__dataclass_fields__.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, default=field.default)


SUBJECT = TrialSubject(
    play=play,
    options=options,
    summary=lambda trials: {"buildings": len(trials), "found": found(trials)},
    is_good=lambda trials: found(trials) >= 0.95 * len(trials),
    results="trials",
    seed_makes="a building, the start and all noise",
)
