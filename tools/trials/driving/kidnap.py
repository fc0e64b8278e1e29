"""Lifts a robot and puts it down elsewhere, on the map of a real building; the log is a CARMEN file.

    python -m tools.trials kidnap [--log FILE] [--seeds N] [--whole-map]

The mapper makes the trajectory of the whole log. In each trial, localization drives two stretches of the log,
one after the other: the second one begins elsewhere, and odometry does not show it. The map of a trial leaves
out the scans of the second stretch, so that localization knows the building only by other scans. The robot is
found again when its pose is certain and right, and is never certain and wrong after that until the end of the
stretch. It must be found within 15 m. The tool also says for what distance the pose was certain and wrong.

With `--whole-map`, the map contains all scans, also those with which localization is tried.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_mp.logs.recording.carmen import CarmenLog
from robbie_mp.logs.recording.carmen_records import LaserRecord, OdometryRecord
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.localization.likelihood_field import LikelihoodField
from robbie_robots.workers.localization.localizer import Localizer
from robbie_robots.workers.mapping.grid_mapper import GridMapper
from robbie_robots.workers.mapping.occupancy_grid import GrowingGrid
from robbie_robots.workers.planar_pose import compose, relative, transform_points, wrap_angle
from tools.trials.harness import CannotTry, Case, TrialSubject

LOG = Path(__file__).parents[4] / "shared" / "data" / "intel.clf"
RANGE_MAX_M = 40.0
BEFORE_M, AFTER_M, MOST_M = 10.0, 25.0, 15.0
MOVED_M = 5.0
"""The robot is put down at least this far away."""
RIGHT_M, RIGHT_RAD = 0.3, 0.2
MAX_TRIES = 1000


class LogTooShort(CannotTry):
    """A log in which the robot cannot be lifted from one place to another.

    Example scenarios:
        - `python -m tools.trials kidnap --log FILE` with the log of a drive of 10 m
    """


def _sweep(record: LaserRecord) -> LaserSweep:
    return LaserSweep.from_ranges(
        record.ranges_m, record.angle_min_rad, record.angle_increment_rad, 0.05, RANGE_MAX_M
    )


@dataclass(frozen=True)
class DriveStep:
    """Odometry's pose (x m, y m, heading rad), the right one, and a scan if one was taken there."""

    stamp_s: float
    odometry: NDArray[np.float64]
    true: NDArray[np.float64]
    way_m: float
    scan: LaserRecord | None


@dataclass(frozen=True)
class LiftResult:
    """The result of one lift.

    Attributes:
        seed: chooses the two stretches.
        moved_m: distance from where it was lifted to where it was put down.
        noticed_m: distance driven until the pose was no longer certain; None if it always was.
        found_m: distance driven until the pose was certain and right, and not certain and wrong after that;
            None if it was not.
        uncertain_m: distance driven after that with a pose that was not certain.
        wrong_m: distance driven with a pose that was certain, and wrong.
        worst_after_m: largest error after it was found.
        times_real_time: the log's time, divided by the processor time that localization needed.
    """

    seed: int
    moved_m: float
    noticed_m: float | None
    found_m: float | None
    uncertain_m: float
    wrong_m: float
    worst_after_m: float
    times_real_time: float

    @property
    def is_good(self) -> bool:
        """Whether the robot was found again in time."""
        return self.found_m is not None and self.found_m <= MOST_M


class KidnapBuilding:
    """The drive of a log, with the trajectory that the mapper makes of it."""

    def __init__(self, log: Path) -> None:
        records = list(CarmenLog(log).drive())
        mapper = GridMapper()
        for record in records:
            if isinstance(record, OdometryRecord):
                mapper.add_odometry(record.logger_time_s, (record.x_m, record.y_m, record.theta_rad))
            else:
                mapper.add_scan(record.logger_time_s, _sweep(record))
        track = mapper.trajectory()
        self.resolution_m = mapper.drawn().resolution_m
        self.steps = list(_steps(records, track))

    def map_without(self, stretch: range) -> LikelihoodField:
        """Return the map of all scans but those of a stretch."""
        grid = GrowingGrid(self.resolution_m)
        for number, step in enumerate(self.steps):
            if step.scan is not None and number not in stretch:
                grid.add(step.true[:2], transform_points(step.true, _sweep(step.scan).hits.points))
        cells, corner = grid.cells()
        return LikelihoodField(cells, self.resolution_m, corner)

    def stretch(self, begin: int, length_m: float) -> range:
        """Return the numbers of the steps from one on, for a distance."""
        ways = np.array([step.way_m for step in self.steps])
        return range(begin, int(np.searchsorted(ways, ways[begin] + length_m)))


def _steps(records: list[OdometryRecord | LaserRecord], track: NDArray[np.float64]) -> Iterator[DriveStep]:
    """Join each scan to the odometry record that follows it."""
    odometry = [record for record in records if isinstance(record, OdometryRecord)]
    ways = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track[:, 1:3], axis=0).T))])
    scans = [record for record in records if isinstance(record, LaserRecord)]
    stamps = np.array([record.logger_time_s for record in odometry])
    nearest = {int(np.argmin(np.abs(stamps - scan.logger_time_s))): scan for scan in scans}
    for number, record in enumerate(odometry):
        pose, scan = np.array([record.x_m, record.y_m, record.theta_rad]), nearest.get(number)
        true = track[number, 1:]
        if scan is not None:
            # The scan was taken a little before or after.
            true = compose(true, relative(pose, np.array(scan.robot_pose)))
            pose = np.array(scan.robot_pose)
        yield DriveStep(record.logger_time_s, pose, true, float(ways[number]), scan)


def run_trial(building: KidnapBuilding, seed: int, *, whole_map: bool = False) -> LiftResult:
    """Drive two stretches, and lift the robot between them."""
    random = np.random.default_rng((seed, 17))
    end_m = building.steps[-1].way_m
    if end_m < BEFORE_M + AFTER_M + MOVED_M:
        raise LogTooShort(f"the log's way is {end_m:.0f} m, too short to lift the robot")
    for _ in range(MAX_TRIES):
        begins_m = random.uniform(0.0, end_m - np.array([BEFORE_M, AFTER_M]))
        numbers = np.searchsorted([step.way_m for step in building.steps], begins_m)
        before = building.stretch(int(numbers[0]), BEFORE_M)
        after = building.stretch(int(numbers[1]), AFTER_M)
        moved_m = float(np.hypot(*(building.steps[before[-1]].true - building.steps[after[0]].true)[:2]))
        if moved_m >= MOVED_M and not set(before) & set(after):
            break
    else:
        raise LogTooShort(f"no two stretches of the log are {MOVED_M:g} m apart")
    localizer = Localizer(building.map_without(range(0) if whole_map else after), seed=seed)
    localizer.start_at(building.steps[before[0]].true)
    drive = _Drive(localizer)
    for number in before:
        drive.take(building.steps[number])
    drive.lift()
    begin_m = building.steps[after[0]].way_m
    noticed_m, found_m, wrong_m, uncertain_m, worst_m = None, None, 0.0, 0.0, 0.0
    for one, other in pairwise(building.steps[number] for number in after):
        drive.take(one)
        way_m = one.way_m - begin_m
        off_m, off_rad, certain = drive.state(one)
        is_right = certain and off_m < RIGHT_M and off_rad < RIGHT_RAD
        if not certain and noticed_m is None:
            noticed_m = round(way_m, 2)
        if is_right:
            found_m = way_m if found_m is None else found_m
            worst_m = max(worst_m, off_m)
        elif certain:
            wrong_m += other.way_m - one.way_m
            found_m, uncertain_m, worst_m = None, 0.0, 0.0
        elif found_m is not None:
            uncertain_m += other.way_m - one.way_m
    found_m = None if found_m is None else round(found_m, 2)
    speed = round(drive.log_s / drive.busy_s, 1)
    return LiftResult(
        seed,
        round(moved_m, 1),
        noticed_m,
        found_m,
        round(uncertain_m, 2),
        round(wrong_m, 2),
        round(worst_m, 3),
        speed,
    )


class _Drive:
    """Localization, and odometry that goes on when the robot is lifted."""

    def __init__(self, localizer: Localizer) -> None:
        self.localizer = localizer
        self.busy_s = self.log_s = 0.0
        self._odometry: NDArray[np.float64] = np.zeros(3)
        self._last: DriveStep | None = None
        self._now_s = 0.0

    def lift(self) -> None:
        """Begin elsewhere with the next step; odometry stays where it was."""
        self._last = None

    def take(self, step: DriveStep) -> None:
        """Pass a step to localization."""
        if self._last is not None:
            self._odometry = compose(self._odometry, relative(self._last.odometry, step.odometry))
        passed_s = 0.1 if self._last is None else max(step.stamp_s - self._last.stamp_s, 1e-3)
        self._now_s, self.log_s = self._now_s + passed_s, self.log_s + passed_s
        began_s = time.process_time()
        self.localizer.add_odometry(self._now_s, self._odometry)
        if step.scan is not None:
            self.localizer.add_scan(self._now_s, _sweep(step.scan))
        self.busy_s += time.process_time() - began_s
        self._last = step

    def state(self, step: DriveStep) -> tuple[float, float, bool]:
        """Return the error of the pose (m, rad), and whether it is certain."""
        pose, newest = self.localizer.pose, self.localizer.newest
        if pose is None or newest is None:
            return np.inf, np.inf, False
        turned = abs(float(wrap_angle(pose[2] - step.true[2])))
        return float(np.hypot(*(pose - step.true)[:2])), turned, newest.converged


def building_of(chosen: argparse.Namespace) -> KidnapBuilding:
    """Return the building of the command line's log.

    Raises:
        CannotTry: there is no log.
    """
    if not chosen.log.exists():
        raise CannotTry(f"there is no log {chosen.log}; name one with --log")
    return KidnapBuilding(chosen.log)


def play(case: Case) -> LiftResult:
    """Lift the robot once."""
    return run_trial(case.prepared, case.seed, whole_map=case.options.whole_map)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the log."""
    parser.add_argument("--log", type=Path, default=LOG, help="a CARMEN log (../shared/data/intel.clf)")
    parser.add_argument("--whole-map", action="store_true", help="the map contains all scans")


SUBJECT = TrialSubject(
    play=play,
    options=options,
    prepare=building_of,
    summary=lambda trials: {"lifts": len(trials), "found": sum(trial.is_good for trial in trials)},
    is_good=lambda trials: all(trial.is_good for trial in trials),
    results="trials",
    seed_makes="two stretches of the log",
)
