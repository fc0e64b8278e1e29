"""Notice that odometry has slipped, and find the robot again in its own map.

Where odometry is right, a sweep agrees with the map around it: nearly all of its returns lie on known
surfaces, or in space that no earlier sweep has seen. After a slip, many of them lie in space that was seen as
free. Then the robot is sought in a wider window of poses, without trust in odometry. If the sweep fits two
places there, the robot is lost until it has driven on, and all sweeps since, together, fit only one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.laser.surface_points import SurfacePoints
from robbie_robots.workers.mapping.correlative_search import Around, Found, ScoreField, SearchWindow, search
from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.scan_matcher import Match, ScanMatcher
from robbie_robots.workers.planar_pose import relative, transform_points, wrap_angle

SUSPECT = 0.9  # share of the returns in known space that lie on surfaces, below which a better pose is sought
DOUBTFUL = 0.7  # the same: a sweep below does not fit
CLEARLY_BETTER = 0.15  # a pose found elsewhere must agree or overlap by this much more
FAR_BETTER = 0.3  # the same if only the overlap is suspect, as of a scan of people or of new space
CONVINCING = 0.5  # least share of the returns on surfaces with which a match overrules odometry
LEAST_AGREEMENT = 0.85
MOST_MISSING = 0.1  # share of the map's surfaces around the robot that the sweep looked through
WINDOWS = ((1.5, 0.4, 0.5), (3.0, np.pi, 0.8))  # searched in turn: m, rad, least share of returns on surfaces
DOUBT_PER_M2 = 0.01
RIVAL_M, RIVAL_RAD = 0.3, 0.2  # a place this far from the best one is another place
RIVAL_WORSE = 0.1  # which fits as well if no sweep agrees by more than this less, though it may overlap less
BETWEEN = np.array([0.05, 0.05, 0.02])  # m, m, rad: odometry over the sweeps that are matched together
DECIDING = 6  # sweeps in succession that fit several spots of a corridor, after which odometry decides
LEAST_SCORE = 0.25
NEAR_M = 6.0  # beyond the window: sweeps from there show its surfaces
FAMILIAR_M = 50.0  # along the pose graph, within which its drift is no slip
MOST_SWEEPS = 40
MOST_POINTS = 200
RESOLUTION_M, BLUR_M = 0.1, 0.1
SLIP_DEVIATION = np.array([1.0, 1.0, 0.3])  # of odometry's motion over a slip: m, m, rad
STRAIN_M, STRAIN_RAD = 0.3, 0.1  # off by this and a standard deviation, odometry is suspect
SLIP_DEVIATIONS = 3.0  # off by this too, it has slipped
GAP_DEVIATIONS = 3.0  # of odometry over a gap in which the robot is sought
GAP_REACH = np.array([[0.5, 0.2], [4.0, np.pi]])  # least and most: m, rad
GAP_OVERLAP = 0.5
CARRIED_M, CARRIED_RAD = 0.15, 0.1  # motion in a sweep of a robot that begins to be carried
HARDLY_M, HARDLY_RAD = 0.05, 0.03  # the same if it is carried already
UNKNOWN = 1e-3  # information of a direction of which nothing is known
MOST_LOST = 25  # sweeps that fit nowhere; the next one is taken where odometry says


@dataclass(frozen=True)
class _Undecided:
    """A sweep that fits several places, and its pose by odometry, map frame."""

    guess: NDArray[np.float64]
    sweep: LaserSweep


@dataclass(frozen=True)
class _Sought:
    """What the robot is sought by.

    Attributes:
        sweep: The newest sweep.
        guess: Its pose by odometry, map frame.
        window: The poses to search.
        least_overlap: Least share of the returns on surfaces.
        places: Which key sweeps count, `(N,)`.
        reference: Numbers of those near the robot.
        hits: Points of the sweep and of the undecided ones before it, in its frame.
        owner: Number of each point's sweep.
        field: Where the points may fit.
        matcher: Matches the points there.
    """

    sweep: LaserSweep
    guess: NDArray[np.float64]
    window: SearchWindow
    least_overlap: float
    places: NDArray[np.bool_]
    reference: list[int]
    hits: SurfacePoints
    owner: NDArray[np.int64]
    field: ScoreField
    matcher: ScanMatcher

    def best(self, apart_from: Around | None = None) -> Found | None:
        """Return the pose that fits best, or the best of those elsewhere."""
        return search(self.field, self.hits.points, self.guess, self.window, LEAST_SCORE, apart_from)


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
        self._undecided: list[_Undecided] = []

    def state(self) -> dict[str, Any]:
        """Return the counters, and the sweeps that fit several places."""
        return {
            "noticed": self.noticed,
            "not_undone": self.not_undone,
            "lost": self.lost,
            "undecided": [{"guess": one.guess, "sweep": one.sweep.state()} for one in self._undecided],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self.noticed, self.not_undone = int(state["noticed"]), int(state["not_undone"])
        self.lost = int(state["lost"])
        self._undecided = [
            _Undecided(np.array(one["guess"]), LaserSweep.from_state(one["sweep"]))
            for one in state.get("undecided", [])
        ]

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
        # People hide the map, and stand where it is free. What is wide stays.
        is_wide = _is_wide(sweep)
        seen = replace(match, on_surface=match.on_surface[is_wide])
        agreement = self._agreement(seen, sweep.hits.thinned(MOST_POINTS).chosen(is_wide), reference)
        is_strained = _is_strained(guess, deviation, match)
        hardly_overlaps = seen.on_surface.mean() < CONVINCING
        if self._undecided or is_strained or hardly_overlaps or agreement < SUSPECT:
            # Farther places may be off by the map's drift, which is no slip: loops are closed there.
            familiar = self._keys.graph.distances_m(len(self._keys) - 1, FAMILIAR_M) <= FAMILIAR_M
            for reach_m, reach_rad, overlap in WINDOWS:
                window = SearchWindow(reach_m, reach_rad, DOUBT_PER_M2)
                other = None if self._undecided else match
                found, is_only = self._found(
                    sweep, guess, window, overlap, familiar, other, agreement, is_strained
                )
                if found is not None and is_only:
                    around = Around(found.pose, RIVAL_M, RIVAL_RAD, _unseen_direction(found))
                    # Odometry led the match there, too, so it may only be as bad as it is known to be.
                    most = SLIP_DEVIATIONS if around.holds(match.pose[None])[0] else 1.0
                    has_slipped = bool(self._undecided) or _is_strained(guess, most * deviation, found)
                    self.noticed += has_slipped
                    self._forget()
                    return found.fused(guess, SLIP_DEVIATION if has_slipped else deviation)
                if found is not None:
                    if self.lost == MOST_LOST:
                        break
                    self.lost += 1
                    self._undecided.append(_Undecided(guess, sweep))
                    return None
                if agreement >= DOUBTFUL and not self._undecided:
                    break
        # New space agrees with everything, so it tells a lost robot nothing.
        if agreement >= DOUBTFUL and not self._undecided and not (self.lost and hardly_overlaps):
            has_slipped = _is_strained(guess, SLIP_DEVIATIONS * deviation, match)
            self.noticed += has_slipped
            self._forget()
            if has_slipped and hardly_overlaps:
                self.not_undone += 1
                return replace(match, pose=guess, information=np.diag(SLIP_DEVIATION**-2.0))
            return match
        self.lost += 1
        if self.lost <= MOST_LOST:
            return None
        self.noticed += 1
        self.not_undone += 1
        self._forget()
        return replace(match, pose=guess, information=np.diag(SLIP_DEVIATION**-2.0))

    def sees_motion(
        self, sweep: LaserSweep, guess: NDArray[np.float64], match: Match, is_carried: bool
    ) -> bool:
        """Return whether a sweep shows that the robot is carried while odometry stands still.

        Args:
            sweep: The sweep.
            guess: The pose of the robot if it stands, map frame.
            match: The match of the sweep.
            is_carried: Whether the sweep before it showed that too. The motion counts as one slip.
        """
        off = match.pose - guess
        off[2] = wrap_angle(off[2])
        least = np.array([HARDLY_M, HARDLY_RAD] if is_carried else [CARRIED_M, CARRIED_RAD])
        if (np.array([np.hypot(off[0], off[1]), abs(off[2])]) < least).all():
            return False
        is_sure = off @ match.information @ off > SLIP_DEVIATIONS**2
        fits = match.on_surface[_is_wide(sweep)].mean() >= SUSPECT  # of people, nothing follows
        sees = bool(is_sure and fits)
        self.noticed += sees and not is_carried
        return sees

    def bridged(
        self, sweep: LaserSweep, guess: NDArray[np.float64], deviation: NDArray[np.float64]
    ) -> Match | None:
        """Find the robot on its map after a gap, in which it moved without sweeps.

        Args:
            sweep: The first sweep after the gap.
            guess: Its pose by odometry, map frame.
            deviation: Odometry's standard deviation over the gap.

        Returns:
            The match, or None if the sweep shows nothing that the map contains, or fits several places.
        """
        self._forget()
        reach_m, reach_rad = np.clip(GAP_DEVIATIONS * deviation[[0, 2]], *GAP_REACH)
        window = SearchWindow(float(reach_m), float(reach_rad), DOUBT_PER_M2)
        found, is_only = self._found(sweep, guess, window, GAP_OVERLAP, np.ones(len(self._keys), np.bool_))
        if found is None or not is_only:
            return None
        return found.fused(guess, deviation)

    def _forget(self) -> None:
        """The robot has a place on the map again."""
        self.lost = 0
        self._undecided.clear()

    def _found(
        self,
        sweep: LaserSweep,
        guess: NDArray[np.float64],
        window: SearchWindow,
        least_overlap: float,
        places: NDArray[np.bool_],
        other: Match | None = None,
        agreement: float = 0.0,
        is_strained: bool = False,
    ) -> tuple[Match | None, bool]:
        """Search a window of poses for one that agrees with some places, clearly better than another match.

        Returns:
            The match, if there is one; and whether there is no other place that fits as well.
        """
        sought = self._sought(sweep, guess, window, least_overlap, places)
        found = None if sought is None else sought.best()
        if sought is None or found is None:
            return None, False
        match = sought.matcher.refine(sought.hits, found.pose)
        agrees = self._agreement(match, sought.hits, sought.reference)
        if agrees < LEAST_AGREEMENT or not self._is_plausible(match, sought):
            return None, False
        # Another spot along a bare corridor is no other place: odometry says how far along it the robot is.
        around = Around(match.pose, RIVAL_M, RIVAL_RAD, _unseen_direction(match))
        is_suspect = is_strained or agreement < SUSPECT
        if other is not None and not self._is_better(
            match, agrees, other, sought, around, is_suspect, is_strained
        ):
            return match if is_strained else None, False
        is_slip = other is not None or bool(self._undecided)  # and not a gap, after which no sweeps are kept
        if is_slip and self.lost < DECIDING:  # the next sweeps may tell the spots from each other
            around = replace(around, along=None)
        rival = self._rival(found, match, sought, around)
        is_only = rival is None or self.lost == MOST_LOST
        if is_only and self._undecided:
            # What all sweeps together show is known only as well as odometry knows the way between them.
            known = match.information @ np.linalg.inv(np.eye(3) + np.diag(BETWEEN**2) @ match.information)
            hits = sweep.hits.chosen(sweep.is_wide).thinned(MOST_POINTS)
            match = sought.matcher.refine(hits, match.pose, match.pose, known)
            match = replace(match, information=match.information + known)
        return match if rival is None else _doubting(match, rival), is_only

    def _sought(
        self,
        sweep: LaserSweep,
        guess: NDArray[np.float64],
        window: SearchWindow,
        least_overlap: float,
        places: NDArray[np.bool_],
    ) -> "_Sought | None":
        """Return what the robot is sought by, or None if nothing that lasts is known there."""
        apart = np.hypot(*(self._keys.poses - guess)[:, :2].T)
        near = np.flatnonzero(places & (apart < NEAR_M + window.distance_m))[::-1]
        reference = self._keys.spaced(near, MOST_SWEEPS)
        if not reference:
            return None
        # A robot among trunks is found by them, because several sweeps saw them; people were elsewhere.
        surfaces = self._keys.lasting_surfaces(reference, but_all_if_few=False)
        if not len(surfaces):
            return None
        field = ScoreField(surfaces.points, RESOLUTION_M, BLUR_M, window.distance_m)
        together = self._together(sweep, guess)
        return _Sought(
            sweep, guess, window, least_overlap, places, reference, *together, field, ScanMatcher(surfaces)
        )

    def _is_better(
        self,
        match: Match,
        agrees: float,
        other: Match,
        sought: "_Sought",
        around: Around,
        is_suspect: bool,
        is_strained: bool,
    ) -> bool:
        """Return whether a match, with all `around` it, is clearly better than that near odometry's pose."""
        refined = sought.matcher.refine(sought.hits, other.pose)
        is_same = bool(around.holds(refined.pose[None])[0])
        if is_same and is_strained:
            return True  # only odometry speaks against it
        # If it converges to the place found, the fit at its own pose counts.
        other = sought.matcher.fit(sought.hits, other.pose) if is_same else refined
        agreement = self._agreement(other, sought.hits, sought.reference)
        better = match.on_surface.mean() - other.on_surface.mean()
        # Where most returns lie on surfaces, the others may be people where the map is free.
        if other.on_surface.mean() < DOUBTFUL:
            better = max(better, agrees - agreement)
        # Of a place that hardly overlaps the map, agreement says little: it is a share of few returns.
        agrees_less = other.on_surface.mean() >= CONVINCING and agrees < agreement
        is_better = not agrees_less and better >= (CLEARLY_BETTER if is_suspect else FAR_BETTER)
        if is_strained or not is_better:
            return bool(is_better)
        # New space and people also hide the map. After a slip, the sweep looks through its walls.
        return self._missing(other, sought) - self._missing(match, sought) >= MOST_MISSING

    def _rival(self, found: Found, match: Match, sought: "_Sought", around: Around) -> Match | None:
        """Return whether another place than those `around` a match fits as well.

        Along a bare corridor, odometry decides; where the sweep does not fit there, nothing is decided yet.
        """
        hits, matcher = sought.hits, sought.matcher
        if around.along is not None:
            there = matcher.fit(hits, match.fused(sought.guess, SLIP_DEVIATION).pose)
            if there.on_surface.mean() < match.on_surface.mean() - RIVAL_WORSE:
                return there
        second = sought.best(Around(found.pose, RIVAL_M + RESOLUTION_M, RIVAL_RAD, around.along))
        rival = None if second is None else matcher.refine(hits, second.pose)
        if rival is None or around.holds(rival.pose[None])[0]:
            return None
        agreements = self._agreements(match, hits, sought.reference, sought.owner)
        rivals = self._agreements(rival, hits, sought.reference, sought.owner)
        is_one = bool((rivals >= agreements - RIVAL_WORSE).all()) and self._is_plausible(rival, sought)
        return rival if is_one else None

    def _together(
        self, sweep: LaserSweep, guess: NDArray[np.float64]
    ) -> tuple[SurfacePoints, NDArray[np.int64]]:
        """Join a sweep with the undecided ones before it: the points in its frame, and each point's sweep."""
        every = [
            one.sweep.hits.chosen(one.sweep.is_wide).moved(relative(guess, one.guess))
            for one in self._undecided
        ]
        every.append(sweep.hits.chosen(sweep.is_wide))
        owner = np.repeat(np.arange(len(every)), [len(one) for one in every])
        step = -(-len(owner) // (MOST_POINTS * min(len(every), 2)))
        joined = SurfacePoints.joined(every)
        return SurfacePoints(joined.points[::step], joined.normals[::step]), owner[::step]

    def _is_plausible(self, found: Match, sought: "_Sought") -> bool:
        """Return whether enough returns lie on surfaces, and the sweep did not look through others."""
        if found.on_surface.mean() < sought.least_overlap:
            return False
        return bool(sought.sweep.looked_through(self._around(found, sought.places)).mean() <= MOST_MISSING)

    def _missing(self, match: Match, sought: "_Sought") -> float:
        """Return the share of the map's surfaces in the sweep's view that it looked through."""
        surfaces, sweep = self._around(match, sought.places), sought.sweep
        beams = sweep.beams_at(np.arctan2(surfaces[:, 1], surfaces[:, 0]))
        near = (beams < len(sweep)) & (np.hypot(*surfaces.T) < NEAR_M)
        return float(sweep.looked_through(surfaces[near]).mean()) if near.any() else 0.0

    def _around(self, match: Match, places: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the map's surfaces around a match as seen from there, `(N, 2)`, m."""
        apart = np.hypot(*(self._keys.poses - match.pose)[:, :2].T)
        nearest = np.argsort(apart, kind="stable")
        reference = self._keys.spaced(nearest[places[nearest]].tolist(), MOST_SWEEPS)
        return self._keys.lasting_surfaces(reference).seen_from(match.pose).points

    def _agreement(self, match: Match, hits: SurfacePoints, reference: list[int]) -> float:
        """Return the share of the returns in space seen before that lie on the surfaces seen there."""
        if match.on_surface.mean() >= SUSPECT:
            return float(match.on_surface.mean())  # at least
        return float(self._agreements(match, hits, reference, np.zeros(len(hits), np.int64))[0])

    def _agreements(
        self, match: Match, hits: SurfacePoints, reference: list[int], owner: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return the same for the points of each sweep: `(owners,)`."""
        places = transform_points(match.pose, hits.points)
        through = np.zeros(len(places), dtype=bool)
        for number in reference:
            seen_from = relative(self._keys.poses[number], np.zeros(3))
            through |= self._keys.sweeps[number].looked_through(transform_points(seen_from, places))
        both_saw = np.bincount(owner, match.on_surface | through)
        agreeing = np.bincount(owner, match.on_surface)
        return np.divide(agreeing, both_saw, out=np.ones(len(both_saw)), where=both_saw > 0)


def _is_wide(sweep: LaserSweep) -> NDArray[np.bool_]:
    """Return which of a sweep's hits, thinned, show wide things."""
    return sweep.is_wide[:: -(-len(sweep.hits) // MOST_POINTS)]


def _unseen_direction(match: Match) -> NDArray[np.float64] | None:
    """Return the direction `(2,)` in which a match by the sweep alone knows less than odometry after a slip.

    None if there is none, or if the match knows no direction better.
    """
    covariance = np.linalg.inv(match.information + UNKNOWN * np.eye(3))
    variances, directions = np.linalg.eigh(covariance[:2, :2])
    along: NDArray[np.float64] = directions[:, 1]
    return along if variances[0] < SLIP_DEVIATION[0] ** 2 <= variances[1] else None


def _doubting(match: Match, rival: Match) -> Match:
    """Return a match that does not tell its pose from that of its rival."""
    off = rival.pose - match.pose
    off[2] = wrap_angle(off[2])
    covariance = np.linalg.inv(match.information + UNKNOWN * np.eye(3)) + np.outer(off, off)
    return replace(match, information=np.asarray(np.linalg.inv(covariance), np.float64))


def _is_strained(guess: NDArray[np.float64], deviation: NDArray[np.float64], match: Match) -> bool:
    """Return whether odometry is farther from a match than it should be if both are right."""
    off = match.pose - guess
    far = np.array([np.hypot(off[0], off[1]), abs(wrap_angle(off[2]))])
    least = np.maximum([STRAIN_M, STRAIN_RAD], deviation[[0, 2]])
    return bool((far > least).any())
