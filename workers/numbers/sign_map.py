"""What is known about signs: where posts stand, which digit each carries, and from where it was looked at.

A digit counts when several views agree; a board that shows something else is refused in the same way.
"""

import math
import string
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points = NDArray[np.float64]

SAME_PLACE_M = 0.55
SECTORS = 12
"""A board may face in this many directions."""
ALL_SECTORS = (1 << SECTORS) - 1
LOOK_RAD = math.radians(36)
"""A look covers the directions that are this near to that of the camera."""
MIN_VIEWS, MIN_PLACES = 3, 2
"""A sign is sure after this many views of it, from this many places."""
SURE_M = 3.4
"""Views from farther away do not make a sign sure, and count against nothing: the board may be on another
post."""
APART_M = 0.4
"""Views from places that are nearer than this to one another may all show the same wrong thing."""
MAX_PLACES = 24
OTHER = ""
READ, OVERLOOKED, MISREAD = math.log(0.9 / 0.02), math.log(0.3 / 0.98), math.log(0.001 / 0.02)
"""Logarithms of how much more probable it is with a digit than with something else that the digit is read
from a place, or something else, or another digit. Measured with 60 signs in
seven fonts; but a few digits are overlooked from 5 of 12 places."""
SURE, REFUSED = 4.0, -2.0
"""A digit is sure if the sum over all places is at least the first, and refused if at most the second."""
MIN_OTHER_PX, MIN_OTHER_WIDTH = 40.0, 0.8
"""A board without a digit is refused only if it was seen this high and, as a share of that, this wide."""
POSE_SPREAD_M, SPREAD_PER_M = 0.04, 0.02


@dataclass
class SightingPlace:
    """A place from where a sign was seen.

    Attributes:
        xy_m: m, map frame.
        votes: number of views from there for each text that was read; '' for something else.
    """

    xy_m: tuple[float, float]
    votes: Counter[str] = field(default_factory=Counter)

    @property
    def text(self) -> str:
        """Return what was read most often from there; of a digit and something else, the digit."""
        return max(self.votes, key=lambda one: (self.votes[one], one))


@dataclass
class Sign:
    """A post, with or without a sign.

    Attributes:
        xy_m: (2,), map frame: mean of all views.
        weight: sum of the weights of all views, 1/m².
        places: from where it was seen, at least APART_M apart.
        glimpses: number of views from farther than SURE_M for each text.
        facing: (2,), sum of unit vectors out of its front, weighted.
        searched: bit k is set if the camera has looked at it from where a board can be read that faces in the
            direction k.
        is_on_map: whether the newest map shows a post there.
    """

    xy_m: Points
    weight: float = 0.0
    places: list[SightingPlace] = field(default_factory=list)
    glimpses: Counter[str] = field(default_factory=Counter)
    facing: Points = field(default_factory=lambda: np.zeros(2))
    searched: int = 0
    is_on_map: bool = False

    @property
    def votes(self) -> Counter[str]:
        """Return the number of views from near for each text that was read; '' for something else."""
        total: Counter[str] = Counter()
        for place in self.places:
            total += place.votes
        return total

    @property
    def text(self) -> str | None:
        """Return what it shows, '' for something else than a digit; None as long as that is not sure."""
        texts, votes = Counter(place.text for place in self.places), self.votes
        best = max(string.digits, key=lambda digit: evidence(digit, texts))
        for text, is_likely in (
            (best, evidence(best, texts) >= SURE),
            (OTHER, evidence(best, texts) <= REFUSED),
        ):
            if is_likely and votes[text] >= MIN_VIEWS and texts[text] >= MIN_PLACES:
                return text
        return None

    @property
    def likely(self) -> str:
        """Return the digit that was read most often, also if it is not sure; '' for none."""
        read = [text for text in self.votes + self.glimpses if text != OTHER]
        return max(read, key=self.times, default="")

    def times(self, text: str) -> int:
        """Return the number of views of a digit, also of those from far away."""
        return self.votes[text] + self.glimpses[text]

    @property
    def is_seen(self) -> bool:
        """Return whether any view shows a board here."""
        return bool(self.places or self.glimpses)

    @property
    def facing_rad(self) -> float:
        """Return the direction in which it can be read; NaN if it has not been read."""
        return math.atan2(self.facing[1], self.facing[0]) if self.facing.any() else math.nan

    @property
    def is_open(self) -> bool:
        """Return whether it may still turn out to carry a digit."""
        return self.text is None and (self.searched != ALL_SECTORS or bool(self.likely))

    def vote(self, text: str, eye_xy_m: Sequence[float]) -> None:
        """Count a view that shows a text, or OTHER, from a place."""
        eye = float(eye_xy_m[0]), float(eye_xy_m[1])
        if math.dist(eye, self.xy_m) > SURE_M:
            self.glimpses[text] += 1
            return
        nearest = min(self.places, key=lambda place: math.dist(place.xy_m, eye), default=None)
        is_full = len(self.places) >= MAX_PLACES
        if nearest is None or (math.dist(nearest.xy_m, eye) >= APART_M and not is_full):
            nearest = SightingPlace(eye)
            self.places.append(nearest)
        nearest.votes[text] += 1

    def place(self, xy_m: Points, distance_m: float) -> None:
        """Take a measurement of its place into account."""
        weight = (POSE_SPREAD_M + SPREAD_PER_M * distance_m) ** -2
        self.xy_m = self.xy_m + weight / (self.weight + weight) * (xy_m - self.xy_m)
        self.weight += weight


class SignMap:
    """All signs and posts that were seen."""

    def __init__(self) -> None:
        self.signs: list[Sign] = []

    def see(
        self, text: str, xy_m: ArrayLike, facing_rad: float, eye_xy_m: Sequence[float], height_px: float
    ) -> Sign:
        """Add a view of a board with a digit.

        Args:
            text: the digit.
            xy_m: (2,), its post, map frame.
            facing_rad: the direction it seems to face, map frame.
            eye_xy_m: where the camera was, m, map frame.
            height_px: height of the board in the image.
        """
        place = np.asarray(xy_m, float)
        sign = self._at(place, math.dist(place, eye_xy_m[:2]))
        sign.vote(text, eye_xy_m)
        sign.facing = sign.facing + height_px**2 * np.array([math.cos(facing_rad), math.sin(facing_rad)])
        return sign

    def see_other(self, xy_m: ArrayLike, eye_xy_m: Sequence[float], height_px: float, width: float) -> None:
        """Add a view of a board without a digit, if the view was good enough to tell.

        Args:
            xy_m: (2,), its post, map frame.
            eye_xy_m: where the camera was, m, map frame.
            height_px: height of the board in the image.
            width: width of the board in the image, as a share of its height.
        """
        if height_px >= MIN_OTHER_PX and width >= MIN_OTHER_WIDTH:
            place = np.asarray(xy_m, float)
            self._at(place, math.dist(place, eye_xy_m[:2])).vote(OTHER, eye_xy_m)

    def see_posts(self, posts_m: Points) -> None:
        """Take the posts (N, 2), m, of a new map: new ones may carry signs, and some were none."""
        for sign in self.signs:
            sign.is_on_map = False
        for post in posts_m:
            sign = self._nearest(post) or self._new(post)
            sign.is_on_map = True
            if not sign.weight:
                sign.xy_m = np.asarray(post)
        self.signs = [sign for sign in self.signs if sign.is_on_map or sign.is_seen]

    @property
    def posts_m(self) -> Points:
        """Return the posts (N, 2), m, that the newest map shows."""
        return np.array([sign.xy_m for sign in self.signs if sign.is_on_map]).reshape(-1, 2)

    def look(self, sign: Sign, eye_xy_m: Sequence[float]) -> None:
        """Record that the camera has looked at a sign from a place where it can be read."""
        x, y = (np.asarray(eye_xy_m, float)[:2] - sign.xy_m).tolist()
        sign.searched |= covered(math.atan2(y, x))

    def _at(self, xy_m: Points, distance_m: float) -> Sign:
        sign = self._nearest(xy_m) or self._new(xy_m)
        sign.place(xy_m, distance_m)
        return sign

    def _new(self, xy_m: Points) -> Sign:
        self.signs.append(Sign(np.asarray(xy_m)))
        return self.signs[-1]

    def _nearest(self, xy_m: Points) -> Sign | None:
        if not self.signs:
            return None
        away = [math.dist(sign.xy_m, xy_m) for sign in self.signs]
        best = int(np.argmin(away))
        return self.signs[best] if away[best] <= SAME_PLACE_M else None

    def state(self) -> list[dict[str, Any]]:
        """Return all signs as plain data."""
        return [
            {
                **vars(sign),
                "places": [[*place.xy_m, dict(place.votes)] for place in sign.places],
                "glimpses": dict(sign.glimpses),
            }
            for sign in self.signs
        ]

    def restore(self, state: Iterable[Mapping[str, Any]]) -> None:
        """Restore the data that `state` returned."""
        self.signs = [
            Sign(
                **{
                    **entry,
                    "places": [SightingPlace((x, y), Counter(votes)) for x, y, votes in entry["places"]],
                    "glimpses": Counter(entry["glimpses"]),
                }
            )
            for entry in state
        ]


def evidence(digit: str, texts: Mapping[str, int]) -> float:
    """Return how much what was read speaks for a digit and against something else: a logarithm.

    Args:
        digit: the digit.
        texts: for each text, from how many places it was read; '' for something else.
    """
    worth = {digit: READ, OTHER: OVERLOOKED}
    return sum(places * worth.get(text, MISREAD) for text, places in texts.items())


def sector_rad(number: int) -> float:
    """Return one of the directions in which a board may face."""
    return number * math.tau / SECTORS


def covered(direction_rad: float, within_rad: float = LOOK_RAD) -> int:
    """Return which directions a look covers, from the side of a post to which a direction points: bits."""
    bits = 0
    for number in range(SECTORS):
        if abs(math.remainder(direction_rad - sector_rad(number), math.tau)) <= within_rad:
            bits |= 1 << number
    return bits


class SheetVotes:
    """Reads the order from several images of a sheet.

    Args:
        order: what an earlier process has read.
    """

    def __init__(self, order: str = "") -> None:
        self.order = order
        self._votes: dict[str, int] = {}

    def see(self, text: str) -> None:
        """Take one reading; the first that three images agree on is the order. No digit may appear twice."""
        if self.order or len(set(text)) != len(text):
            return
        self._votes[text] = self._votes.get(text, 0) + 1
        if self._votes[text] >= MIN_VIEWS:
            self.order = text
