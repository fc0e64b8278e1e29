"""Notice that odometry has slipped, and find the robot again in its own map.

Where odometry is right, a sweep agrees with the map around it: nearly all of its returns lie on known
surfaces, or in space that no earlier sweep has seen. After a slip, many of them lie in space that was seen as
free. Then the robot is sought in a wider window of poses, without trust in odometry.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.laser.laser_sweep import LaserSweep
from workers.laser.surface_points import SurfacePoints
from workers.mapping.correlative_search import ScoreField, Window, search
from workers.mapping.key_sweeps import KeySweeps
from workers.mapping.scan_matcher import Match, ScanMatcher
from workers.planar_pose import relative, transform_points, wrap_angle

SUSPECT = 0.9  # share of the returns in known space that lie on surfaces, below which a better pose is sought
DOUBTFUL = 0.7  # the same: a sweep below does not fit
CLEARLY_BETTER = 0.15  # a pose found elsewhere must agree or overlap by this much more
LEAST_AGREEMENT = 0.85
MOST_MISSING = 0.1  # share of the map's surfaces around the robot that the sweep looked through
WINDOWS = ((1.5, 0.4, 0.5), (3.0, np.pi, 0.8))  # searched in turn: m, rad, least share of returns on surfaces
DOUBT_PER_M2 = 0.01
LEAST_SCORE = 0.25
NEAR_M = 6.0  # beyond the window: sweeps from there show its surfaces
MOST_SWEEPS = 40
MOST_POINTS = 200
RESOLUTION_M, BLUR_M = 0.1, 0.1
SLIP_DEVIATION = np.array([1.0, 1.0, 0.3])  # of odometry's motion over a slip: m, m, rad
STRAIN_M, STRAIN_RAD = 0.3, 0.1  # off by this and a standard deviation, odometry is suspect
SLIP_DEVIATIONS = 3.0  # off by this too, it has slipped
MOST_LOST = 25  # sweeps that fit nowhere; the next one is taken where odometry says


class SlipWatch:
    """Decides whether sweeps fit the map, and looks for the robot where they do not.

    Args:
        keys: The map's sweeps.

    Attributes:
        noticed: Number of slips noticed.
        not_undone: Number of those after which the robot was not found in its map.
        lost: Number of sweeps in succession that did not fit.
    """

    def __init__(self, keys: KeySweeps) -> None:
        self._keys = keys
        self.noticed = 0
        self.not_undone = 0
        self.lost = 0

    def state(self) -> dict[str, int]:
        """Return the counters."""
        return {"noticed": self.noticed, "not_undone": self.not_undone, "lost": self.lost}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self.noticed, self.not_undone = int(state["noticed"]), int(state["not_undone"])
        self.lost = int(state["lost"])

    def checked(
        self,
        sweep: LaserSweep,
        guess: NDArray[np.float64],
        deviation: NDArray[np.float64],
        match: Match,
        reference: list[int],
    ) -> Match | None:
        """Check the match of a new sweep, and seek a better one if it does not fit.

        Args:
            sweep: The sweep.
            guess: Its pose by odometry, map frame.
            deviation: Odometry's standard deviation.
            match: The match near odometry's pose.
            reference: Numbers of the key sweeps that were matched.

        Returns:
            The match to use, or None if the sweep fits nowhere. After `MOST_LOST` of those, the result is
            odometry's pose with the uncertainty of a slip.
        """
        hits = sweep.hits.thinned(MOST_POINTS)
        agreement = self._agreement(match, hits, reference)
        if _is_strained(guess, deviation, match) or agreement < SUSPECT:
            for reach_m, reach_rad, overlap in WINDOWS:
                window = Window(reach_m, reach_rad, DOUBT_PER_M2)
                found = self._found(hits, guess, window, match, agreement)
                if found is not None and self._is_plausible(found, sweep, overlap):
                    self.noticed += 1
                    self.lost = 0
                    return replace(found, information=found.information + np.diag(SLIP_DEVIATION**-2.0))
                if agreement >= DOUBTFUL:
                    break
        if agreement >= DOUBTFUL:
            self.noticed += _is_strained(guess, SLIP_DEVIATIONS * deviation, match)
            self.lost = 0
            return match
        self.lost += 1
        if self.lost <= MOST_LOST:
            return None
        self.noticed += 1
        self.not_undone += 1
        self.lost = 0
        return replace(match, pose=guess, information=np.diag(SLIP_DEVIATION**-2.0))

    def _found(
        self,
        hits: SurfacePoints,
        guess: NDArray[np.float64],
        window: Window,
        other: Match,
        agreement: float,
    ) -> Match | None:
        """Search a window of poses. Return a match that agrees with the map clearly better than another."""
        apart = np.hypot(*(self._keys.poses - guess)[:, :2].T)
        near = np.flatnonzero(apart < NEAR_M + window.distance_m)[::-1]
        reference = self._keys.spaced(near, MOST_SWEEPS)
        if not reference:
            return None
        surfaces = self._keys.surfaces(reference)
        field = ScoreField(surfaces.points, RESOLUTION_M, BLUR_M, window.distance_m)
        found = search(field, hits.points, guess, window, LEAST_SCORE)
        if found is None:
            return None
        match = ScanMatcher(surfaces).refine(hits, found.pose)
        agrees = self._agreement(match, hits, reference)
        overlap, other_overlap = match.on_surface.mean(), other.on_surface.mean()
        if agrees < max(LEAST_AGREEMENT, agreement):
            return None
        is_better = max(agrees - agreement, overlap - other_overlap) >= CLEARLY_BETTER
        return match if is_better else None

    def _is_plausible(self, found: Match, sweep: LaserSweep, least_overlap: float) -> bool:
        """Return whether enough returns lie on surfaces, and the sweep did not look through others."""
        if found.on_surface.mean() < least_overlap:
            return False
        apart = np.hypot(*(self._keys.poses - found.pose)[:, :2].T)
        reference = self._keys.spaced(np.argsort(apart, kind="stable").tolist(), MOST_SWEEPS)
        surfaces = self._keys.surfaces(reference).points
        seen_from = relative(found.pose, np.zeros(3))
        return bool(sweep.looked_through(transform_points(seen_from, surfaces)).mean() <= MOST_MISSING)

    def _agreement(self, match: Match, hits: SurfacePoints, reference: list[int]) -> float:
        """Return the share of the returns in space seen before that lie on the surfaces seen there."""
        if match.on_surface.mean() >= SUSPECT:
            return float(match.on_surface.mean())  # at least
        places = transform_points(match.pose, hits.points)
        through = np.zeros(len(places), dtype=bool)
        for number in reference:
            seen_from = relative(self._keys.poses[number], np.zeros(3))
            through |= self._keys.sweeps[number].looked_through(transform_points(seen_from, places))
        both_saw = int((match.on_surface | through).sum())
        return int(match.on_surface.sum()) / both_saw if both_saw else 1.0


def _is_strained(guess: NDArray[np.float64], deviation: NDArray[np.float64], match: Match) -> bool:
    """Return whether odometry is farther from a match than it should be if both are right."""
    off = match.pose - guess
    far = np.array([np.hypot(off[0], off[1]), abs(wrap_angle(off[2]))])
    least = np.maximum([STRAIN_M, STRAIN_RAD], deviation[[0, 2]])
    return bool((far > least).any())
