"""Follows persons from scan to scan by their legs.

Each track has a Kalman filter with constant velocity. Each scan's legs go to the tracks so that the sum of
the distances is least (Hungarian method), at most two to each. In outline: Leigh, Pineau, Olmedo and Zhang,
"Person tracking and following with 2D laser scanners" (ICRA 2015).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]

FAR = 1e6
"""Cost of a leg that is out of a track's reach."""
MAX_STEP_S = 1.0
"""After a longer pause, speeds are forgotten."""
MAX_LATE_S = 0.3
"""With several lasers: a scan that is older than the newest one by more is ignored, others count as now."""
NEWEST_SHARE = 0.1
"""Share of the newest scan in what is known about a track's legs."""


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of the tracker.

    Attributes:
        leg_probability: Things less likely legs are ignored.
        birth_probability: A new track begins at things at least this likely.
        apart_m: No new track begins this near to another one.
        legs_apart_m: The legs of a person are at most this far apart.
        gate_m: A leg is at most this far from where its person is expected.
        gate_sigmas: The same in standard deviations.
        acceleration_m_per_s2: Standard deviation of a person's acceleration.
        one_leg_m: Standard deviation of a person's place by one leg.
        two_legs_m: The same by two legs.
        hits: A track is confirmed after this number of scans with a leg.
        confidence: Mean probability of the legs of a person that has not moved.
        moved_m: Whatever has moved this far, and not along what the map shows, is a person.
        unseen_s: A track ends when nothing was where it should be seen for this time.
        hidden_s: The same while something else hides that place.
        unseen_new_s: The same for a track that is not confirmed.
        speed_decay_s: Time constant with which an unseen person is expected to stop.
        max_tracks: Beyond this number, tracks end: first those that were seen least often.
    """

    leg_probability: float = 0.2
    birth_probability: float = 0.4
    apart_m: float = 0.35
    legs_apart_m: float = 0.6
    gate_m: float = 0.6
    gate_sigmas: float = 3.0
    acceleration_m_per_s2: float = 1.5
    one_leg_m: float = 0.16
    two_legs_m: float = 0.07
    hits: int = 5
    confidence: float = 0.5
    moved_m: float = 0.6
    unseen_s: float = 1.0
    hidden_s: float = 4.0
    unseen_new_s: float = 0.35
    speed_decay_s: float = 0.8
    max_tracks: int = 40


class TrackedPerson(NamedTuple):
    """A person.

    Attributes:
        number: the same as long as the person is tracked.
        xy_m: `(2,)`, m, map frame.
        velocity_m_per_s: `(2,)`.
        confidence: 0 to 1, how likely its legs are legs.
        has_moved: whether it has moved since it was first seen.
        unseen_s: time since a leg was seen.
        two_legs: 0 to 1, how often two legs were seen lately.
    """

    number: int
    xy_m: Array
    velocity_m_per_s: Array
    confidence: float
    has_moved: bool
    unseen_s: float
    two_legs: float


@dataclass
class _Track:
    number: int
    state: Array  # x, y (m), velocity (m/s)
    spread: Array  # (4, 4)
    born_xy_m: Array
    seen_s: float
    confidence: float
    on_map: float  # how often it was on something that the map shows, 0 to 1
    two_legs: float  # how often two legs were seen, 0 to 1
    hits: int = 1
    has_moved: bool = False

    @property
    def is_on_map(self) -> bool:
        return self.on_map > 0.5


def _nothing_hidden(_xy_m: Array) -> bool:
    return False


class PersonTracker:
    """Tracks persons. Call `see` with each scan.

    Attributes:
        dropped: Number of tracks that ended because there were more than `max_tracks`.
    """

    def __init__(self, settings: TrackerSettings | None = None) -> None:
        self.settings = settings or TrackerSettings()
        self.dropped = 0
        self._tracks: list[_Track] = []
        self._next = 1
        self._now_s: float | None = None
        self._seen_s: dict[str, float] = {}  # stamp of each laser's newest scan

    @property
    def now_s(self) -> float:
        """Return the time of the tracks, s: the newest stamp of a scan; 0 before the first one."""
        return self._now_s or 0.0

    def see(
        self,
        stamp_s: float,
        legs_m: Array,
        probabilities: Array,
        is_on_map: NDArray[np.bool_] | None = None,
        is_hidden: Callable[[Array], bool] = _nothing_hidden,
        laser: str = "",
    ) -> None:
        """Take the segments of a scan.

        Several lasers take turns: each scan corrects the tracks of those whom it sees. So somebody whom two
        lasers see is one person, with at most two legs in each scan.

        Args:
            stamp_s: time of the scan; one that is not later than the laser's last is ignored, unless time has
                jumped back: then everybody is forgotten.
            legs_m: (N, 2), m, map frame, middles of what may be legs.
            probabilities: (N,), how likely each is a leg.
            is_on_map: (N,), whether the map shows something there.
            is_hidden: says whether something hides a place (2,), m, map frame, from the laser.
            laser: which laser's scan it is, if there are several.
        """
        last_s = self._seen_s.get(laser)
        if last_s is not None and stamp_s <= last_s:
            if stamp_s > last_s - MAX_STEP_S:
                return
            self._tracks, self._now_s, self._seen_s, last_s = [], None, {}, None
        elif self._now_s is not None and stamp_s < self._now_s - MAX_LATE_S:
            return
        self._seen_s[laser] = stamp_s
        stamp_s = max(stamp_s, self._now_s or stamp_s)
        self._predict(stamp_s, MAX_STEP_S if last_s is None else stamp_s - last_s)
        likely = probabilities >= self.settings.leg_probability
        on_map = np.zeros(len(likely), np.bool_) if is_on_map is None else is_on_map
        legs, chances, on_map = legs_m[likely], probabilities[likely], on_map[likely]
        free = np.ones(len(legs), np.bool_)
        for track, taken in zip(self._tracks, self._shared_out(legs, chances, on_map), strict=True):
            if taken:
                free[taken] = False
                self._correct(
                    track, legs[taken], float(chances[taken].max()), bool(on_map[taken].any()), stamp_s
                )
        self._end_old(stamp_s, is_hidden)
        self._begin(stamp_s, legs[free], chances[free], on_map[free])

    @property
    def persons(self) -> list[TrackedPerson]:
        """Return who is tracked and likely a person."""
        return [self._told(track) for track in self._tracks if self._is_person(track)]

    @property
    def things(self) -> list[TrackedPerson]:
        """Return what looks like the legs of a person, but is on the map and has not moved.

        It may be furniture, or somebody who has stood there since the map shows the place.
        """
        return [
            self._told(track)
            for track in self._tracks
            if self._looks_like_legs(track) and not self._is_person(track)
        ]

    def _told(self, track: _Track) -> TrackedPerson:
        return TrackedPerson(
            track.number,
            track.state[:2].copy(),
            track.state[2:].copy(),
            track.confidence,
            track.has_moved,
            self.now_s - track.seen_s,
            track.two_legs,
        )

    def _is_person(self, track: _Track) -> bool:
        return self._looks_like_legs(track) and (track.has_moved or not track.is_on_map)

    def _looks_like_legs(self, track: _Track) -> bool:
        is_likely = track.has_moved or track.confidence >= self.settings.confidence
        return track.hits >= self.settings.hits and is_likely

    def _predict(self, stamp_s: float, period_s: float) -> None:
        """Move the tracks on; a person is unseen after more than two periods of a laser's scans."""
        step_s = 0.0 if self._now_s is None else stamp_s - self._now_s
        self._now_s = stamp_s
        is_pause, step_s = step_s > MAX_STEP_S, min(step_s, MAX_STEP_S)
        move = np.eye(4)
        move[0, 2] = move[1, 3] = step_s
        push = np.array([[step_s**2 / 2, 0], [0, step_s**2 / 2], [step_s, 0], [0, step_s]])
        noise = push @ push.T * self.settings.acceleration_m_per_s2**2
        for track in self._tracks:
            if is_pause:
                track.state[2:] = 0.0
            elif stamp_s - track.seen_s > 2 * period_s:
                track.state[2:] *= np.exp(-step_s / self.settings.speed_decay_s)
            track.state = move @ track.state
            track.spread = move @ track.spread @ move.T + noise

    def _shared_out(self, legs: Array, chances: Array, on_map: NDArray[np.bool_]) -> list[list[int]]:
        """Return which legs belong to each track: none, one or two."""
        tracks, settings = self._tracks, self.settings
        taken: list[list[int]] = [[] for _ in tracks]
        if not tracks or not len(legs):
            return taken
        cost = np.full((2 * len(tracks), len(legs)), FAR)
        for index, track in enumerate(tracks):
            offset = legs - track.state[:2]
            spread = track.spread[:2, :2] + np.eye(2) * settings.one_leg_m**2
            squared = np.einsum("ni,ij,nj->n", offset, np.linalg.inv(spread), offset)
            reach = (squared <= settings.gate_sigmas**2) & (np.hypot(*offset.T) <= settings.gate_m)
            # A thing on the map is rather that thing than the leg of somebody who walks past.
            wrong = 4.0 * (on_map & (not track.is_on_map))
            # Without the spread's size, a hidden person, who may be anywhere, would take the legs of others.
            size = float(np.log(np.linalg.det(spread) / settings.one_leg_m**4))
            own = np.where(reach, squared + size - 2 * np.log(chances) + wrong, FAR)
            cost[2 * index], cost[2 * index + 1] = own, np.where(reach, own + 0.5, FAR)
        for row, leg in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, leg] < FAR:
                taken[row // 2].append(int(leg))
        for track, pair in zip(tracks, taken, strict=True):
            if len(pair) == 2 and np.hypot(*(legs[pair[0]] - legs[pair[1]])) > settings.legs_apart_m:
                pair.remove(max(pair, key=lambda leg: float(np.hypot(*(legs[leg] - track.state[:2])))))
        return taken

    def _correct(self, track: _Track, legs: Array, chance: float, on_map: bool, stamp_s: float) -> None:
        """Correct a track by one or two legs."""
        settings = self.settings
        sigma_m = settings.two_legs_m if len(legs) == 2 else settings.one_leg_m
        seen = track.spread[:2, :2] + np.eye(2) * sigma_m**2
        gain = track.spread[:, :2] @ np.linalg.inv(seen)
        track.state = track.state + gain @ (legs.mean(axis=0) - track.state[:2])
        track.spread = track.spread - gain @ track.spread[:2]
        track.hits += 1
        track.seen_s = stamp_s
        track.confidence += NEWEST_SHARE * (chance - track.confidence)
        track.two_legs += NEWEST_SHARE * ((len(legs) == 2) - track.two_legs)
        # A map that has grown since the track began may show now what the thing is.
        track.on_map += NEWEST_SHARE * (on_map - track.on_map)
        # What goes over from one thing on the map to the next one does not walk.
        if not track.is_on_map and np.hypot(*(track.state[:2] - track.born_xy_m)) >= settings.moved_m:
            track.has_moved = True

    def _end_old(self, stamp_s: float, is_hidden: Callable[[Array], bool]) -> None:
        """End tracks that were not seen for too long, and one of two at the same place."""
        settings = self.settings
        kept: list[_Track] = []
        for track in sorted(self._tracks, key=lambda one: (-one.seen_s, not one.has_moved, one.number)):
            unseen_s = stamp_s - track.seen_s
            limit_s = settings.unseen_s if track.hits >= settings.hits else settings.unseen_new_s
            if unseen_s > limit_s and is_hidden(track.state[:2]) and limit_s == settings.unseen_s:
                limit_s = settings.hidden_s
            is_double = unseen_s > 0.0 and any(
                np.hypot(*(other.state[:2] - track.state[:2])) < settings.apart_m / 2 for other in kept
            )
            if unseen_s <= limit_s and not (is_double and track.hits < settings.hits):
                kept.append(track)
        self._tracks = sorted(kept, key=lambda one: one.number)

    def _begin(self, stamp_s: float, legs: Array, chances: Array, on_map: NDArray[np.bool_]) -> None:
        """Begin tracks at legs that belong to none, at the likeliest ones first."""
        settings = self.settings
        left = [int(leg) for leg in np.argsort(-chances) if chances[leg] >= settings.birth_probability]
        while left:
            leg = left.pop(0)
            near = [
                other for other in left if np.hypot(*(legs[other] - legs[leg])) <= settings.legs_apart_m / 2
            ]
            pair = [leg, *near[:1]]
            left = [other for other in left if other not in pair]
            place = legs[pair].mean(axis=0)
            if any(np.hypot(*(track.state[:2] - place)) < settings.apart_m for track in self._tracks):
                continue
            self._tracks.append(
                _Track(
                    self._next,
                    np.array([*place, 0.0, 0.0]),
                    np.diag([settings.one_leg_m**2] * 2 + [0.8**2] * 2),
                    place,
                    stamp_s,
                    float(chances[pair].max()),
                    float(on_map[pair].any()),
                    float(len(pair) == 2),
                )
            )
            self._next += 1
        if len(self._tracks) > settings.max_tracks:
            ranked = sorted(self._tracks, key=lambda one: (self._is_person(one), one.hits, one.confidence))
            self.dropped += len(ranked) - settings.max_tracks
            self._tracks = sorted(ranked[-settings.max_tracks :], key=lambda one: one.number)

    def memory(self) -> dict[str, Any]:
        """Return the confirmed tracks as plain data, for a restart."""
        return {
            "next": self._next,
            "now_s": self._now_s,
            "lasers": [[laser, stamp_s] for laser, stamp_s in self._seen_s.items()],
            "tracks": [
                [
                    track.number,
                    *track.state.tolist(),
                    *track.born_xy_m.tolist(),
                    track.seen_s,
                    track.confidence,
                    track.on_map,
                    track.two_legs,
                    track.hits,
                    track.has_moved,
                ]
                for track in self._tracks
                if track.hits >= self.settings.hits
            ],
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Continue with the tracks that `memory` returned."""
        self._next, self._now_s = memory["next"], memory["now_s"]
        self._seen_s = dict(memory.get("lasers", ()))
        self._tracks = [_restored(row) for row in memory["tracks"]]


def _restored(row: Sequence[Any]) -> _Track:
    number, x, y, vx, vy, born_x, born_y, seen_s, confidence, on_map, two_legs, hits, has_moved = row
    return _Track(
        int(number),
        np.array([x, y, vx, vy]),
        np.diag([0.2**2] * 2 + [0.8**2] * 2),
        np.array([born_x, born_y]),
        seen_s,
        confidence,
        float(on_map),
        float(two_legs),
        int(hits),
        bool(has_moved),
    )
