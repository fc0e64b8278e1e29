"""Follow the robot from sweep to sweep by matching each against the key sweeps just before it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.correlative_search import ScoreField, SearchWindow, search
from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.odometry_deviation import OdometryDeviation
from robbie_robots.workers.mapping.scan_matcher import Match, ScanMatcher
from robbie_robots.workers.planar_pose import compose, rotated_information

BACK_M = 10.0  # travel whose key sweeps form the reference
MOST_SWEEPS = 15
MOST_POINTS = 200
RESOLUTION_M = 0.1
BLUR_M = 0.1
DEVIATIONS = 3.0  # standard deviations of odometry's noise that the search covers
LEAST_REACH_M, MOST_REACH_M = 0.25, 1.0
LEAST_REACH_RAD, MOST_REACH_RAD = 0.1, 0.8
TRUST = 0.25  # how much each of a sweep's points counts: neighbours share errors, as of people
DOUBT = 0.01  # subtracted from the score of a fit one standard deviation of odometry away


class ScanTracker:
    """Matches new sweeps against recent key sweeps.

    Args:
        keys: The map's sweeps; call `forget` when they change.

    Attributes:
        odometry_deviation: How far odometry may be off.
    """

    def __init__(self, keys: KeySweeps) -> None:
        self._keys = keys
        self.odometry_deviation = OdometryDeviation()
        self._reference: tuple[ScoreField, ScanMatcher] | None = None
        self._begin_m = -np.inf

    @property
    def begin_m(self) -> float:
        """Travel at which the reference begins: sweeps before it are not matched."""
        return self._begin_m

    def begin(self, travelled_m: float) -> None:
        """Match only the sweeps taken from this travel on, because the robot is lost on the map before it."""
        self._begin_m = travelled_m
        self.forget()

    def reference(self) -> list[int]:
        """Return the numbers of the key sweeps that the next sweep is matched against, newest first."""
        travelled = self._keys.travelled_m
        near = np.flatnonzero(travelled >= max(travelled[-1] - BACK_M, self._begin_m))[::-1]
        return self._keys.spaced(near, MOST_SWEEPS)

    def forget(self) -> None:
        """Choose new reference sweeps for the next match, because the map has changed."""
        self._reference = None

    def match(
        self, sweep: LaserSweep, before: ArrayLike, step: ArrayLike, deviation: NDArray[np.float64]
    ) -> Match:
        """Find where a sweep was taken.

        Args:
            sweep: The sweep.
            before: Pose of the sweep before it, map frame.
            step: Odometry's motion since, in the frame of `before`.
            deviation: Odometry's standard deviation over the step.

        Returns:
            The match, map frame; its information includes that of odometry.
        """
        guess = compose(before, step)
        field, matcher = self._recent()
        window = SearchWindow(
            float(np.clip(DEVIATIONS * deviation[0], LEAST_REACH_M, MOST_REACH_M)),
            float(np.clip(DEVIATIONS * deviation[2], LEAST_REACH_RAD, MOST_REACH_RAD)),
            DOUBT / deviation[0] ** 2,
            DOUBT / deviation[2] ** 2,
        )
        hits = sweep.hits.thinned(MOST_POINTS)
        prior = rotated_information(np.diag(deviation**-2.0), guess[2])
        found = search(field, hits.points, guess, window)
        # In a corridor, more of a sweep fits farther back. So a fit near the guess may be the better one.
        starts = [guess] if found is None else [guess, found.pose]
        fits = [matcher.refine(hits, start, guess, prior) for start in starts]
        costs = [matcher.cost(hits, fit, window.distance_m, guess, prior) for fit in fits]
        return fits[int(np.argmin(costs))].informed(prior)

    def judging(
        self, sweep: LaserSweep, match: Match, guess: NDArray[np.float64], deviation: NDArray[np.float64]
    ) -> Match:
        """Return the match of a sweep's wide things with another standard deviation of odometry.

        It serves to judge odometry, so people have no part in it.
        """
        prior = rotated_information(np.diag(deviation**-2.0), guess[2])
        hits = sweep.hits.chosen(sweep.is_wide).thinned(MOST_POINTS)
        return self._recent()[1].refine(hits, match.pose, guess, prior).informed(prior)

    def _recent(self) -> tuple[ScoreField, ScanMatcher]:
        if self._reference is None:
            surfaces = self._keys.lasting_surfaces(self.reference())
            field = ScoreField(surfaces.points, RESOLUTION_M, BLUR_M, MOST_REACH_M)
            self._reference = field, ScanMatcher(surfaces, TRUST)
        return self._reference
