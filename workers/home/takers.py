"""Knows who may have given an order, and finds the person who takes what the robot brings."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.home.follow import PersonReport
from robbie_robots.workers.home.household_states import HouseholdSettings

Array = NDArray[np.float64]

MAX_GIVERS = 8
STILL_HERE_M = 0.5
"""Until the robot has driven this far, it looks for the person who has given the order."""


class _Giver(NamedTuple):
    """Somebody who may have given the order; the likeliest is the least."""

    has_one_leg: bool
    is_aside: bool
    away_m: float
    xy_m: tuple[float, float]


class Takers:
    """The persons around the robot, in the light of an order.

    Args:
        settings: of the household.

    Attributes:
        pose: the robot's pose, (3,), x, y (m) and heading (rad), map frame; None: not known yet.
        persons: all persons that are tracked now.
        things: what looks like the legs of standing persons, but is on the map: it may be furniture.
        given_at: the pose where the order was given.
    """

    def __init__(self, settings: HouseholdSettings) -> None:
        self.settings = settings
        self.pose: Array | None = None
        self.persons: list[PersonReport] = []
        self.things: list[PersonReport] = []
        self.given_at: Array | None = None
        self._givers: dict[str, _Giver] = {}
        self._is_where_given = False
        self.begin_task()

    def begin_task(self) -> None:
        """Forget who has not taken what the robot has brought."""
        self._taker_xy_m: Array | None = None
        self._refusals: list[Array] = []

    def order_is_given_here(self) -> None:
        """Note where the robot is, and where those stand to whom it may bring things."""
        self.given_at = None if self.pose is None else self.pose.copy()
        self._givers, self._is_where_given = {}, True
        self.note_givers()

    def note_givers(self) -> None:
        """Note where the persons stand who may have given the order: the one in front, or else the nearest.

        Corners of furniture look like one leg, so they come last.

        Persons need a moment to be noticed, so the robot goes on with it until it has driven away.
        """
        if not self._is_where_given or self.pose is None or self.given_at is None:
            return
        x, y, heading = self.given_at.tolist()
        self._is_where_given = math.dist(self.pose[:2], (x, y)) <= STILL_HERE_M
        for one in self._fresh(self.persons) if self._is_where_given else ():
            away_m = math.dist(one.xy_m, (x, y))
            bearing = math.atan2(one.xy_m[1] - y, one.xy_m[0] - x)
            is_aside = abs(math.remainder(bearing - heading, math.tau)) > self.settings.front_rad
            if away_m <= self.settings.person_m and (
                one.name in self._givers or len(self._givers) < MAX_GIVERS
            ):
                has_one_leg = one.two_legs < self.settings.two_legs
                self._givers[one.name] = _Giver(has_one_leg, is_aside, away_m, one.xy_m)

    def likely_givers(self) -> list[Array]:
        """Return where those stand who may have given the order and have not refused, the likeliest first."""
        places = [np.array(giver.xy_m) for giver in sorted(self._givers.values())]
        return [xy_m for xy_m in places if not self._has_refused(xy_m)]

    def offer_to(self, xy_m: Array) -> None:
        """Note who is about to take what the robot has brought."""
        self._taker_xy_m = xy_m

    def refuses(self) -> None:
        """Record that this person has not taken it, and is not asked again."""
        if self._taker_xy_m is not None:
            self._refusals.append(self._taker_xy_m)
            self._taker_xy_m = None

    def taker(self, waits: bool) -> Array | None:
        """Return where the person is who should take what the robot brings; None if nobody is seen.

        Args:
            waits: whether only the person who gave the order may take it, if the robot has seen that person.
        """
        assert self.pose is not None
        persons, things = (
            [xy_m for one in self._fresh(seen) if not self._has_refused(xy_m := np.asarray(one.xy_m))]
            for seen in (self.persons, self.things)
        )
        settings = self.settings
        givers = self.likely_givers()
        for giver in givers:
            # Near by, the legs of somebody who stands get on the map as those of furniture do. But here the
            # robot has seen a person before.
            for places, within_m in ((persons, settings.same_m), (things, settings.thing_m)):
                away = [(math.dist(place, giver), tuple(place)) for place in places]
                if away and min(away)[0] <= within_m:
                    return np.array(min(away)[1])
        if givers and waits:
            return None
        away = [(self.direction(place)[0], tuple(place)) for place in persons]
        return np.array(min(away)[1]) if away and min(away)[0] <= settings.person_m else None

    def _has_refused(self, xy_m: Array) -> bool:
        """Return whether nobody there has taken the object: what looked like legs may be furniture."""
        return any(math.dist(place, xy_m) <= self.settings.refused_m for place in self._refusals)

    def direction(self, xy_m: Array) -> tuple[float, float]:
        """Return how far away a place is, m, and its bearing, rad, map frame."""
        assert self.pose is not None
        x, y = (xy_m - self.pose[:2]).tolist()
        return math.hypot(x, y), math.atan2(y, x)

    def _fresh(self, persons: Iterable[PersonReport]) -> list[PersonReport]:
        return [one for one in persons if one.unseen_s <= self.settings.fresh_s]

    def memory(self) -> dict[str, Any]:
        """Return what the next process needs, as plain data."""
        return {
            "given_at": None if self.given_at is None else self.given_at.tolist(),
            "givers": {name: [*giver[:-1], *giver.xy_m] for name, giver in self._givers.items()},
            "is_where_given": self._is_where_given,
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on with what `memory` returned."""
        self.given_at = None if memory["given_at"] is None else np.array(memory["given_at"])
        self._is_where_given = memory["is_where_given"]
        for name, (has_one_leg, is_aside, away_m, x, y) in memory["givers"].items():
            self._givers[name] = _Giver(has_one_leg, is_aside, away_m, (x, y))
