"""Races on random courses.

    python -m tools.trials parcours --seeds 20

Says for each course the touches and the mean time of two laps, and how the speed compares with a driver that
knows the course: it drives the way of least curvature that keeps the same distance to everything, as fast as
the robot's limits allow. Mean speed is the length of the middle of the way, divided by the time of a lap.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.simulation.course import Course, random_course
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.workers.parcours.race_driver import RaceDriver, RaceLimits
from tools.trials.driving.swept import swept
from tools.trials.harness import TrialSubject

Array = NDArray[np.float64]
SWEEP_S, COMMAND_S, VALID_S = 0.1, 0.05, 0.3
LAPS = 2
LIMIT_S = 400.0
ROUNDS = 4000
MOST_BEND_PER_M = 3.0


@dataclass(frozen=True)
class Race:
    """How a race went.

    Attributes:
        touches: collisions.
        lap_s: mean time of a lap; infinite if the robot did not finish.
        length_m: of the middle of the way.
        reference_s: time of a lap of the driver that knows the course.
    """

    touches: int
    lap_s: float
    length_m: float
    reference_s: float

    @property
    def ratio(self) -> float:
        """Speed in relation to the driver that knows the course."""
        return self.reference_s / self.lap_s


class Laps:
    """Counts laps by the true pose, as referees do."""

    def __init__(self, middle: Array) -> None:
        self._middle = middle
        self._station = 0
        self.done = 0.0

    def see(self, x_m: float, y_m: float) -> None:
        """Take the next place of the robot."""
        away = np.hypot(self._middle[:, 0] - x_m, self._middle[:, 1] - y_m)
        count = len(self._middle)
        station = int(away.argmin())
        step = (station - self._station + count // 2) % count - count // 2
        self.done += step / count
        self._station = station


def race(course: Course, seed: int, laps: int = LAPS) -> Race:
    """Drive some laps in the simulation; the laser sees ten times a second."""
    now_s = [0.0]
    drive = SimulatedDrive(course.arena, lambda: now_s[0], seed=seed)
    geometry = LaserGeometry()
    laser = SimulatedLaser(course.arena, geometry, seed=seed)
    driver = RaceDriver()
    referee, next_sweep_s, speeds = Laps(course.middle), 0.0, (0.0, 0.0)
    while referee.done < laps and now_s[0] < LIMIT_S:
        truth = drive.ground_truth()
        referee.see(truth.pose.x_m, truth.pose.y_m)
        if now_s[0] >= next_sweep_s - 1e-9:
            next_sweep_s += SWEEP_S
            laser.place(truth.pose, truth.stamp_s)
            speeds = driver.drive(swept(laser), truth.linear_m_per_s)
        drive.command(*speeds, VALID_S)
        now_s[0] += COMMAND_S
    length_m = _length(course.middle)
    lap_s = now_s[0] / laps if referee.done >= laps else math.inf
    return Race(drive.collisions, lap_s, length_m, reference_s(course, driver.limits))


def reference_s(course: Course, limits: RaceLimits) -> float:
    """Return the time of a lap of a driver that knows the course."""
    low, high = _bounds(course, limits.body_radius_m + limits.margin_m)
    offset = (low + high) / 2
    for _ in range(ROUNDS):  # relaxes towards the way of least bending
        way = course.middle + offset[:, None] * course.normals
        pull = (np.roll(way, 1, axis=0) + np.roll(way, -1, axis=0)) / 2 - way
        smooth = pull - (np.roll(pull, 1, axis=0) + np.roll(pull, -1, axis=0)) / 2
        step = 0.3 * pull + 0.3 * smooth
        offset = np.clip(offset + (step * course.normals).sum(axis=1), low, high)
    return _lap_s(course.middle + offset[:, None] * course.normals, limits)


def _bounds(course: Course, away_m: float) -> tuple[Array, Array]:
    """Return how far to the right and left of the middle the robot's middle may be at each station."""
    half_m = course.width_m / 2 - away_m
    low, high = np.full(len(course.middle), -half_m), np.full(len(course.middle), half_m)
    for x_m, y_m, radius_m in course.arena.circles:
        to = np.array([x_m, y_m]) - course.middle
        across = (to * course.normals).sum(axis=1)
        along = np.sqrt(np.maximum((to**2).sum(axis=1) - across**2, 0.0))
        reach_m = radius_m + away_m
        near = (along < reach_m) & (np.abs(across) < course.width_m)
        half_chord = np.sqrt(np.maximum(reach_m**2 - along**2, 0.0))
        left = near & (across > 0)
        high[left] = np.minimum(high[left], (across - half_chord)[left])
        right = near & (across <= 0)
        low[right] = np.maximum(low[right], (across + half_chord)[right])
    return low, np.maximum(low, high)


def _lap_s(way: Array, limits: RaceLimits) -> float:
    """Return the least time of a flying lap on a way, within the robot's limits."""
    steps = np.hypot(*(np.roll(way, -1, axis=0) - way).T)
    heading = np.arctan2(*(np.roll(way, -1, axis=0) - way).T[::-1])
    turn = (heading - np.roll(heading, 1) + math.pi) % (2 * math.pi) - math.pi
    bend = np.clip(turn / ((steps + np.roll(steps, 1)) / 2), -MOST_BEND_PER_M, MOST_BEND_PER_M)
    speed = limits.fastest(bend)
    for _ in range(2):  # a flying lap: the second round knows how the first one ended
        for index in range(len(way)):
            reached = math.sqrt(speed[index - 1] ** 2 + 2 * limits.braking_m_per_s2 * steps[index - 1])
            speed[index] = min(speed[index], reached)
        for index in reversed(range(len(way))):
            following = speed[(index + 1) % len(way)]
            speed[index] = min(
                speed[index], math.sqrt(following**2 + 2 * limits.braking_m_per_s2 * steps[index])
            )
    return float((steps / ((speed + np.roll(speed, -1)) / 2)).sum())


def _length(way: Array) -> float:
    return float(np.hypot(*(np.roll(way, -1, axis=0) - way).T).sum())


def is_clean(one: Race) -> bool:
    """Return whether the robot finished without a touch."""
    return one.touches == 0 and math.isfinite(one.lap_s)


def summary(races: list[Race]) -> dict[str, float]:
    """Return the figures of all races together."""
    return {
        "races": len(races),
        "clean": sum(map(is_clean, races)),
        "touches": sum(one.touches for one in races),
        "speed_mean_m_per_s": round(sum(one.length_m / one.lap_s for one in races) / len(races), 3),
        "ratio_mean": round(sum(one.ratio for one in races) / len(races), 2),
        "ratio_least": round(min(one.ratio for one in races), 2),
    }


SUBJECT = TrialSubject(
    play=lambda case: race(random_course(case.seed), case.seed),
    summary=summary,
    is_good=lambda races: all(map(is_clean, races)),
    results="races",
    seed_makes="a course",
)
