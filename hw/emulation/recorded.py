"""A recorded drive behind emulated devices: the base moves and the laser sees as it was recorded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.emulation.body import WheeledBody
from robbie_robots.hw.pose import wrapped

Array = NDArray[np.float64]

# Records may have stamps that jitter: between two of them the base may not be faster than this.
MAX_M_PER_S, MAX_RAD_PER_S = 2.5, 6.0


@dataclass(frozen=True)
class RecordedDrive:
    """When, after the start, the robot was where, and what its laser saw.

    Attributes:
        times_s: (N,) of the records, ascending.
        ways_m: (N,) way forward since the start.
        turns_rad: (N,) turn since the start, positive to the left.
        sweeps: ranges, m, by the number of the sweep since the start.
        sweep_period_s: time between sweeps.
    """

    times_s: Array
    ways_m: Array
    turns_rad: Array
    sweeps: dict[int, NDArray[np.float32]]
    sweep_period_s: float

    @property
    def duration_s(self) -> float:
        """Return the time from start to end."""
        return float(self.times_s[-1])


def recorded_drive(
    stamps_s: Sequence[float],
    poses: Array,
    sweeps: Sequence[NDArray[np.float32] | None],
    sweep_period_s: float,
    rate: float = 1.0,
) -> RecordedDrive:
    """Make a drive from records, each of which is a pose or a pose with a sweep.

    The laser measures at fixed times, so the drive waits for the next of these where a sweep was recorded.

    Args:
        stamps_s: when the records were made; they do not go back.
        poses: (N, 3) by wheel odometry: x, y, heading.
        sweeps: ranges, m, of each record; None: it has none.
        sweep_period_s: time between sweeps of the laser.
        rate: how many times as fast as recorded.
    """
    steps = np.diff(poses, axis=0)
    turns_rad = np.array([wrapped(turn) for turn in steps[:, 2]])
    middle_rad = poses[:-1, 2] + turns_rad / 2
    chords_m = steps[:, 0] * np.cos(middle_rad) + steps[:, 1] * np.sin(middle_rad)
    # The base drives arcs.
    ways_m = chords_m / np.sinc(turns_rad / (2 * np.pi))
    least_s = np.maximum(np.abs(ways_m) / MAX_M_PER_S, np.abs(turns_rad) / MAX_RAD_PER_S)
    waits_s = np.maximum(np.diff(stamps_s) / rate, least_s)
    times_s = [0.0]
    numbered: dict[int, NDArray[np.float32]] = {}
    for index, sweep in enumerate(sweeps):
        if index:
            times_s.append(times_s[-1] + float(waits_s[index - 1]))
        if sweep is not None:
            # Each sweep has a number of its own.
            number = max(int(np.ceil(times_s[-1] / sweep_period_s)), max(numbered, default=-1) + 1)
            numbered[number] = sweep
            times_s[-1] = number * sweep_period_s
    return RecordedDrive(
        np.array(times_s),
        np.concatenate([[0.0], np.cumsum(ways_m)]),
        np.concatenate([[0.0], np.cumsum(turns_rad)]),
        numbered,
        sweep_period_s,
    )


class RecordedBody(WheeledBody):
    """A body that moves as it was recorded, whatever its motors are told.

    Args:
        drive: the recorded drive.
        start_s: returns the true time at which the drive starts.
    """

    def __init__(self, drive: RecordedDrive, start_s: Callable[[], float]) -> None:
        self._drive, self._start_s = drive, start_s
        self._told = (0.0, 0.0)

    def move(
        self, linear_m_per_s: float, angular_rad_per_s: float, passed_s: float, at_s: float
    ) -> tuple[float, float]:
        """Tell how far the wheels have turned since the last call."""
        now_s, drive = at_s - self._start_s(), self._drive
        here = (
            float(np.interp(now_s, drive.times_s, drive.ways_m)),
            float(np.interp(now_s, drive.times_s, drive.turns_rad)),
        )
        before, self._told = self._told, here
        return here[0] - before[0], here[1] - before[1]
