"""Wheel odometry in order of arrival, and its interpolation at a sweep's stamp."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.planar_pose import compose, relative
from robbie_robots.workers.row_log import RowLog

SAME_STAMP_S = 1e-4
SEARCHED = 200  # newest entries searched first for a sweep's stamp
PAUSE_S, PAUSE_PERIODS = 0.5, 4  # a pause is longer than both
STOPPED = 0.25  # share of the way at its speed before; a robot that drives less in a pause has stopped
SPEED_S = 0.35  # time over which the speed before a pause is taken


@dataclass(frozen=True)
class TrackMoment:
    """A moment in the track.

    Attributes:
        position: Number of the odometry entry since the beginning; between two entries, a fraction.
        pose: Odometry's pose then (x, y, heading), odometry frame.
    """

    position: float
    pose: NDArray[np.float64]


class OdometryTrack:
    """Stamps and poses of odometry in recording order.

    Args:
        most_entries: Maximum number of entries. Beyond it, the older half is dropped.
    """

    def __init__(self, most_entries: int) -> None:
        self.log = RowLog(4, most_entries)

    def add(self, stamp_s: float, pose: ArrayLike) -> None:
        """Append an entry: its stamp and the pose (x m, y m, heading rad)."""
        self.log.add([stamp_s, *np.asarray(pose, float)])

    def numbered(self, position: int) -> TrackMoment:
        """Return an entry by its number, or the nearest one if that was dropped or is yet to come."""
        row = int(np.clip(position - self.log.forgotten, 0, len(self.log) - 1))
        return TrackMoment(row + self.log.forgotten, self.log.rows[row, 1:].copy())

    def at(self, stamp_s: float) -> TrackMoment | None:
        """Find the place of a stamp, or None if it is not between the entries.

        Stamps may be out of order if the clock jitters; the order of recording counts. So this returns the
        newest entry with exactly this stamp. If there is none, it takes the newest pair of successive entries
        with the stamp between them, and interpolates the pose.
        """
        begin = max(0, len(self.log) - SEARCHED)
        if begin and stamp_s < self.log.rows[begin, 0]:
            begin = 0  # the sweep comes very late
        newest = self.log.rows[begin:]
        stamps = newest[:, 0]
        same = np.flatnonzero(np.abs(stamps - stamp_s) < SAME_STAMP_S)
        if len(same):
            return self.numbered(self.log.forgotten + begin + int(same[-1]))
        around = np.flatnonzero((stamps[:-1] < stamp_s) & (stamp_s < stamps[1:]))
        if len(around) == 0:
            return None
        before, after = newest[around[-1]], newest[around[-1] + 1]
        share = (stamp_s - before[0]) / (after[0] - before[0])
        pose = compose(before[1:], share * relative(before[1:], after[1:]))
        return TrackMoment(self.log.forgotten + begin + around[-1] + share, pose)

    def moved(self, begin: float, end: float) -> NDArray[np.float64]:
        """Return the length of the way between two positions, m; 0; and the turns on it, added up, rad."""
        first, last = (int(np.ceil(position)) - self.log.forgotten for position in (begin, end))
        rows = self.log.rows[max(first - 1, 0) : last + 1]
        steps = relative(rows[:-1, 1:], rows[1:, 1:])
        return np.array([np.hypot(steps[:, 0], steps[:, 1]).sum(), 0.0, np.abs(steps[:, 2]).sum()])

    def longest_pause(self, begin: float, end: float) -> tuple[float, float]:
        """Return the longest time between two successive entries from one position to another, s.

        The second figure is how far the robot would have driven in it at its speed before, m. It is 0 if
        odometry moved a good part of that, or is always that rare.
        """
        first, last = int(np.floor(begin)) - self.log.forgotten, int(np.ceil(end)) - self.log.forgotten
        first = max(first, 0)
        pauses_s = np.diff(self.log.rows[first : last + 1, 0])
        if not len(pauses_s):
            return 0.0, 0.0
        at = first + int(np.argmax(pauses_s))
        pause_s = float(pauses_s.max())
        if not self._is_long(pause_s):
            return pause_s, 0.0
        rows = self.log.rows[max(0, at - SEARCHED) : at + 1]
        rows = rows[rows[:, 0] >= rows[-1, 0] - SPEED_S]
        way_m, time_s = np.hypot(*np.diff(rows[:, 1:3], axis=0).T).sum(), rows[-1, 0] - rows[0, 0]
        coasted_m = float(way_m / time_s * pause_s) if time_s > 0.0 else 0.0
        has_stopped = np.hypot(*np.diff(self.log.rows[at : at + 2, 1:3], axis=0)[0]) < STOPPED * coasted_m
        return pause_s, coasted_m if has_stopped else 0.0

    def is_in_pause(self, place: TrackMoment, least_m: float, least_rad: float) -> bool:
        """Return whether a place lies in a pause of the odometry in which the robot moved.

        Where the robot was then is not known: it may have stood for most of the pause.

        Args:
            place: A place between the newest entries.
            least_m: A shorter way is no motion.
            least_rad: Likewise for turns.
        """
        first = int(np.floor(place.position)) - self.log.forgotten
        rows = self.log.rows[max(0, first) : first + 2]
        if place.position == np.floor(place.position) or len(rows) < 2:
            return False
        pause_s = rows[1, 0] - rows[0, 0]
        if not self._is_long(pause_s):
            return False
        step = relative(rows[0, 1:], rows[1, 1:])
        return bool(np.hypot(step[0], step[1]) > least_m or abs(step[2]) > least_rad)

    def _is_long(self, pause_s: float) -> bool:
        """Return whether a time between two entries is longer than it usually is."""
        periods_s = np.diff(self.log.rows[-SEARCHED:, 0])
        return pause_s > max(PAUSE_S, PAUSE_PERIODS * float(np.median(periods_s)))
