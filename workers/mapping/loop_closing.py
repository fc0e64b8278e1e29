"""Close loops: recognise a place the robot has seen before, and join the new sweep to the old ones there.

A candidate lies near the robot on the map, within the possible drift along the pose graph (Olson, "Robust and
efficient robotic mapping", 2008). It is accepted only if the surfaces agree and neither side looked through a
surface that the other hit. This rejects places that only look alike.

Where no loop has been closed for long, places anywhere on the map that look alike are candidates too
(`place_index`). Such a loop is closed when several places in succession agree on where the robot is, each of
them known in all directions. A loop that later ones contradict is taken back.

A loop that would move the map farther than the pose graph's own uncertainty allows needs more evidence: a
near one, several places that agree; a far one, many.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.mapping.correlative_search import ScoreField, SearchWindow, search
from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.place_index import PlaceIndex
from robbie_robots.workers.mapping.scan_matcher import Match, ScanMatcher
from robbie_robots.workers.planar_pose import (
    compose,
    relative,
    rotated_information,
    transform_points,
    wrap_angle,
)

EVERY_M = 0.5  # of travel between two searches for a loop
LEAST_LOOP_M = 8.0
NEAR_M = 3.0
DRIFT_PER_M, MOST_DRIFT_M = 0.02, 4.0
LEAST_REACH_M = 0.3
MOST_CANDIDATES = 2
AROUND_M = 5.0  # travel before and after an old sweep whose sweeps show its place
BACK_M = 3.0  # the newest travel, whose sweeps are matched together
MOST_SWEEPS = 30
QUERY_POINTS, CHECKED_POINTS = 300, 1000
RESOLUTION_M = 0.1
BLUR_M = 0.1
LEAST_SCORE = 0.25
LEAST_OVERLAP = 0.4
LEAST_AGREEMENT = 0.9  # share of the surfaces that both saw
MOST_MISSING = 0.1  # share of the old surfaces that the new sweeps looked through
SAME_M = 0.1
SETTLED_M = 0.03  # an edge that disagrees with the map by less waits for others
MOST_WAITING = 30
MOST_ALIKE = 50  # places that wait for others that agree with them
LONG_M = 25.0  # travel without a closed loop, after which places far away on the map are candidates
FAR_REACH_M, FAR_REACH_RAD = 2.0, 0.3
FAR_DRIFT = 0.3  # greatest drift, as a share of the travel
FAR_OVERLAP, FAR_DEVIATION = 0.6, np.array([0.1, 0.1, 0.05])  # m, m, rad
UNKNOWN = 1e-3  # information of a direction of which nothing is known
AGREEING, AGREEING_WITHIN_M = 4, 25.0  # places that must agree, and the travel on which they lie
MANY_AGREEING, MANY_WITHIN_M = 12, 60.0  # the same for an improbable loop far away
PLACE_M = 2.0  # travel after which the robot is at another place
LARGE_M, LARGE_RAD = 0.1, 0.03  # loops that move the map by less are not weighed against its uncertainty
IMPROBABLE = 3.0  # standard deviations
SLACK = np.array([0.05, 0.05, 0.01])  # m, m, rad: the map's uncertainty is at least this
SLIGHTLY_WORSE = 0.05  # share of surfaces by which a fit where the map has the robot may be worse
SAME_PLACE = np.array([0.5, 0.5, 0.1])  # m, m, rad: what places that agree may differ by, and
SAME_PER_M = 0.02  # m for each m of travel between them


@dataclass(frozen=True)
class _Alike:
    """An old key sweep, the newer one that may be there, and its pose in the frame of the old one."""

    old: int
    new: int
    offset: NDArray[np.float64]
    information: NDArray[np.float64]


class LoopCloser:
    """Looks for loops at new key sweeps and keeps the pose graph settled.

    Attributes:
        closed: Number of loops closed.
        taken_back: Number of those that later ones contradicted.
    """

    def __init__(self, keys: KeySweeps) -> None:
        self._keys = keys
        self._looked_at_m = 0.0
        self._waiting = 0
        self._closed_at_m = 0.0
        self._places = PlaceIndex(keys)
        self._alike: deque[_Alike] = deque(maxlen=MOST_ALIKE)
        self.closed = 0
        self.taken_back = 0

    def state(self) -> dict[str, Any]:
        """Return the progress of the search."""
        return {
            "looked_at_m": self._looked_at_m,
            "waiting": self._waiting,
            "closed": self.closed,
            "closed_at_m": self._closed_at_m,
            "taken_back": self.taken_back,
            "places": self._places.state(),
            "alike": [
                {"ends": (one.old, one.new), "offset": one.offset, "information": one.information}
                for one in self._alike
            ],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self._looked_at_m = float(state["looked_at_m"])
        self._waiting = int(state["waiting"])
        self.closed = int(state["closed"])
        if "places" in state:
            self._closed_at_m, self.taken_back = float(state["closed_at_m"]), int(state["taken_back"])
            self._places.restore(state["places"])
            self._alike.extend(
                _Alike(int(old), int(new), np.array(one["offset"]), np.array(one["information"]))
                for one in state["alike"]
                for old, new in [one["ends"]]
            )

    def renumber(self, new_numbers: NDArray[np.int64]) -> None:
        """Take the new number of each old key sweep `(N,)`: its own, or its heir's."""
        self._places.renumber(new_numbers)
        self._alike.clear()

    def look(self) -> bool:
        """Look for loops at the newest key sweep. Return whether closing one has moved the map."""
        travelled = self._keys.travelled_m
        if travelled[-1] - self._looked_at_m < EVERY_M:
            return False
        self._looked_at_m = float(travelled[-1])
        newest = len(self._keys) - 1
        before = self._keys.poses[newest].copy()
        misfit = 0.0
        for old, reach_m in self._candidates(newest):
            window = SearchWindow(reach_m, float(np.clip(0.1 * (1 + reach_m), 0.0, 0.5)), 0.02 / reach_m**2)
            match = self._recognised(newest, old, before, window, is_near=True)
            if match is None:
                continue
            loop = self._seen(old, newest, match)
            loops = self._supported(loop, AGREEING) if self._is_improbable(loop) else [loop]
            for one in loops:
                self._close(one)
                off = match.pose - before
                misfit = max(misfit, float(np.hypot(off[0], off[1])), abs(float(wrap_angle(off[2]))))
        place = self._places.look()
        if place is not None and travelled[place] - self._closed_at_m > LONG_M:
            for loop in self._far(place):
                self._close(loop)
                misfit = np.inf
        return self.settle() if misfit > SETTLED_M or self._waiting > MOST_WAITING else False

    def settle(self) -> bool:
        """Optimise the graph if edges are waiting for it. Return whether any were."""
        if self._waiting == 0:
            return False
        self._waiting = 0
        self._keys.graph.optimise()
        self.taken_back += self._keys.graph.drop_contradicted()
        return True

    def _seen(self, old: int, new: int, match: Match) -> _Alike:
        base = self._keys.poses[old]
        information = rotated_information(match.information, -base[2])
        return _Alike(old, new, relative(base, match.pose), information)

    def _close(self, loop: _Alike) -> None:
        self._keys.graph.add_edge(loop.old, loop.new, loop.offset, loop.information, closes_loop=True)
        self._closed_at_m = float(self._keys.travelled_m[-1])
        self.closed += 1
        self._waiting += 1

    def _far(self, place: int) -> list[_Alike]:
        """Look for a place anywhere on the map. Return the loops to close, if enough places agree on it."""
        poses, travelled = self._keys.poses, self._keys.travelled_m
        since = travelled[place] - travelled
        apart = np.hypot(*(poses - poses[place])[:, :2].T)
        possible = (since > LONG_M) & (apart < NEAR_M + FAR_DRIFT * since)
        for old, turn in self._places.alike(possible, MOST_CANDIDATES):
            window = SearchWindow(FAR_REACH_M, FAR_REACH_RAD)
            match = self._recognised(place, old, compose(poses[old], [0.0, 0.0, turn]), window)
            if match is None or match.on_surface.mean() < FAR_OVERLAP:
                continue
            one = self._seen(old, place, match)
            covariance = np.linalg.inv(one.information + UNKNOWN * np.eye(3))
            if (np.sqrt(np.diag(covariance)) > FAR_DEVIATION).any():
                continue
            if loops := self._supported(
                one, *((MANY_AGREEING, MANY_WITHIN_M) if self._is_improbable(one) else ())
            ):
                return loops
        return []

    def _is_improbable(self, loop: _Alike) -> bool:
        """Return whether a loop would move the map farther than its uncertainty allows."""
        poses, graph = self._keys.poses, self._keys.graph
        off = _apart(relative(poses[loop.old], poses[loop.new]), loop.offset)
        if not _is_large(off):
            return False
        covariance = graph.covariance_between(loop.old, loop.new) + np.diag(SLACK**2)
        covariance += np.linalg.inv(loop.information + UNKNOWN * np.eye(3))
        return bool(off @ np.linalg.solve(covariance, off) > IMPROBABLE**2)

    def _supported(
        self, loop: _Alike, places: int = AGREEING, within_m: float = AGREEING_WITHIN_M
    ) -> list[_Alike]:
        """Return a loop with those that agree with it, once they come from enough places; else nothing.

        Args:
            loop: The new loop, which is kept as evidence for later ones.
            places: How many places are enough.
            within_m: Greatest travel between two loops that support each other.
        """
        travelled = self._keys.travelled_m
        agreeing = [other for other in self._alike if self._agree(other, loop, within_m)]
        if len({travelled[one.new] // PLACE_M for one in (*agreeing, loop)}) < places:
            self._alike.append(loop)
            return []
        self._alike.clear()
        return [*agreeing, loop]

    def _agree(self, one: _Alike, other: _Alike, within_m: float) -> bool:
        """Return whether two places, one after the other, agree on where the robot is."""
        poses, travelled = self._keys.poses, self._keys.travelled_m
        way_m = float(travelled[other.new] - travelled[one.new])
        if not 0 < way_m < within_m:
            return False
        here = compose(poses[other.old], other.offset)
        there = compose(compose(poses[one.old], one.offset), relative(poses[one.new], poses[other.new]))
        off = np.abs(relative(here, there))
        return bool((off < SAME_PLACE + np.array([1, 1, 0]) * SAME_PER_M * way_m).all())

    def _candidates(self, newest: int) -> list[tuple[int, float]]:
        """Return old sweeps that may be near the robot, best first, and the possible drift (m) of each."""
        poses, travelled = self._keys.poses, self._keys.travelled_m
        apart = np.hypot(*(poses - poses[newest])[:, :2].T)
        turned = np.abs(wrap_angle(poses[:, 2] - poses[newest, 2]))
        possible = (travelled[newest] - travelled > LEAST_LOOP_M) & (apart < NEAR_M + MOST_DRIFT_M)
        if not possible.any():
            return []
        along = self._keys.graph.distances_m(newest, limit_m=MOST_DRIFT_M / DRIFT_PER_M)
        drift = np.minimum(DRIFT_PER_M * along, MOST_DRIFT_M)
        possible &= apart < NEAR_M + drift
        cost = np.where(possible, apart + turned, np.inf)
        found = []
        for _ in range(MOST_CANDIDATES):
            best = int(np.argmin(cost))
            if not np.isfinite(cost[best]):
                break
            found.append((best, LEAST_REACH_M + float(drift[best])))
            cost[np.abs(travelled - travelled[best]) < 2 * AROUND_M] = np.inf
        return found

    def _recognised(
        self,
        newest: int,
        old: int,
        guess: NDArray[np.float64],
        window: SearchWindow,
        *,
        is_near: bool = False,
    ) -> Match | None:
        """Match the newest sweeps, around a guess, with those around an old one.

        Args:
            newest: The sweep whose pose is sought.
            old: The sweep that may have been taken at the same place.
            guess: Where to begin.
            window: The poses to search.
            is_near: Whether the guess is the map's own. It is kept if it fits nearly as well, or if the map's
                certainty outweighs what fits better: of what shows little of one direction, the best fit may
                be anywhere along it.

        Returns:
            The pose of the newest sweep, or None if the places differ.
        """
        keys, travelled = self._keys, self._keys.travelled_m
        since = travelled[newest] - travelled
        there = (np.abs(travelled - travelled[old]) < AROUND_M) & (since > LEAST_LOOP_M)
        reference = keys.spaced(np.flatnonzero(there), MOST_SWEEPS)
        recent = keys.spaced(np.flatnonzero(since < BACK_M)[::-1], MOST_SWEEPS)
        surfaces = keys.surfaces(reference)
        here = keys.surfaces(recent).seen_from(keys.poses[newest]).thinned(QUERY_POINTS)
        field = ScoreField(surfaces.points, RESOLUTION_M, BLUR_M, window.distance_m)
        found = search(field, here.points, guess, window, LEAST_SCORE)
        if found is None:
            return None
        matcher = ScanMatcher(surfaces)
        whole = matcher.refine(here, found.pose)
        if is_near and _is_large(_apart(guess, whole.pose)):
            covariance = keys.graph.covariance_between(old, newest) + np.diag(SLACK**2)
            known = rotated_information(np.linalg.inv(covariance), keys.poses[old, 2])
            own = matcher.refine(here, guess, guess, known)
            is_slight = own.on_surface.mean() >= whole.on_surface.mean() - SLIGHTLY_WORSE
            costs = [matcher.cost(here, one, window.distance_m, guess, known) for one in (own, whole)]
            if is_slight or costs[0] <= costs[1]:
                whole = own
        if whole.on_surface.mean() < LEAST_OVERLAP:
            return None
        seen_through = self._looked_through(
            reference, keys.poses[reference], transform_points(whole.pose, here.points)
        )
        both_saw = whole.on_surface | seen_through
        if whole.on_surface.sum() < LEAST_AGREEMENT * both_saw.sum():
            return None
        moved = compose(whole.pose, relative(keys.poses[newest], keys.poses[recent]))
        if self._looked_through(recent, moved, surfaces.thinned(CHECKED_POINTS).points).mean() > MOST_MISSING:
            return None
        single = matcher.refine(keys.sweeps[newest].hits, whole.pose)
        return single if np.hypot(*(single.pose - whole.pose)[:2]) < SAME_M else None

    def _looked_through(
        self, numbers: list[int], poses: NDArray[np.float64], places: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Return which places `(M, 2)` any of the sweeps, taken at these poses, saw as free."""
        through = np.zeros(len(places), dtype=bool)
        for number, pose in zip(numbers, poses, strict=True):
            through |= self._keys.sweeps[number].looked_through(
                transform_points(relative(pose, np.zeros(3)), places)
            )
        return through


def _apart(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far two poses in the same frame are apart along its axes and in heading."""
    off = other - one
    off[2] = wrap_angle(off[2])
    return off


def _is_large(off: NDArray[np.float64]) -> bool:
    return bool(np.hypot(off[0], off[1]) > LARGE_M or abs(off[2]) > LARGE_RAD)
