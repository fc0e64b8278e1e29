"""Knowledge about victims: their positions, fused over all views, and the operator's verdicts."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.planar_pose import wrap_angle

# Standard deviation of a view's position: that of the robot's own pose, plus a part that grows with the
# square of the distance, as in every measurement by size in an image.
POSE_SPREAD_M, SPREAD_PER_M = 0.03, 0.012
# A view farther than this from the victim's estimated place shows something else, or the map is wrong.
SAME_PLACE_M = 0.6
# After this many such views in a row, the victim's place counts as changed.
BELIEVED = 3
DOUBT_PER_VIEW = 0.6


class VictimState(IntEnum):
    """The state of a victim. The numbers are those of the message `VictimFound`."""

    SUSPECTED = 0
    ASKED = 1
    CONFIRMED = 2
    REJECTED = 3


@dataclass
class Victim:
    """One victim.

    Attributes:
        tag: its number.
        position_m: (3,), map frame: mean of all views, weighted by their quality.
        facing_rad: the direction it faces, map frame.
        first_s: when it was first seen.
        last_s: when it was last seen.
        weight: sum of the weights of all views, 1/m².
        views: number of views.
        best_m: the shortest distance of a view.
        state: its state.
        not_before_s: the operator is not asked about it before this time.
        elsewhere: how many views in a row showed it at another place.
        asked_s: when the operator was last asked.
        questions: how often the operator was asked.
        patch: (rows, columns, 3) uint8, the part of an image that shows it best.
    """

    tag: int
    position_m: NDArray[np.float64]
    facing_rad: float
    first_s: float
    last_s: float
    weight: float = 0.0
    views: int = 0
    best_m: float = math.inf
    state: VictimState = VictimState.SUSPECTED
    not_before_s: float = -math.inf
    elsewhere: int = 0
    asked_s: float = -math.inf
    questions: int = 0
    patch: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))

    @property
    def spread_m(self) -> float:
        """Return the position's standard deviation, m. The share of the robot's pose does not average out."""
        return math.hypot(POSE_SPREAD_M, math.sqrt(1 / self.weight)) if self.weight else math.inf

    @property
    def confidence(self) -> float:
        """Return how certain it is that the victim exists, 0 to 1."""
        return 1.0 - DOUBT_PER_VIEW**self.views

    def place(self, position_m: NDArray[np.float64], facing_rad: float, distance_m: float) -> None:
        """Take a view into account."""
        if np.hypot(*(position_m - self.position_m)[:2]) > SAME_PLACE_M:
            self.elsewhere += 1
            if self.elsewhere < BELIEVED:
                return
            self.weight = 0.0
        self.elsewhere = 0
        weight = (POSE_SPREAD_M + SPREAD_PER_M * distance_m**2) ** -2
        share = weight / (self.weight + weight)
        self.position_m = self.position_m + share * (position_m - self.position_m)
        turn = float(wrap_angle(np.asarray(facing_rad - self.facing_rad)))
        self.facing_rad = float(wrap_angle(np.asarray(self.facing_rad + share * turn)))
        self.weight += weight
        self.views += 1


class VictimMap:
    """All victims seen so far.

    Args:
        enough_views: The operator is asked about a victim after at least this many views,
        enough_spread_m: once the standard deviation of its position is at most this,
        near_m: and the nearest view was from at most this distance.
    """

    def __init__(self, enough_views: int = 4, enough_spread_m: float = 0.06, near_m: float = 2.2) -> None:
        self.victims: dict[int, Victim] = {}
        self._enough_views = enough_views
        self._enough_spread_m = enough_spread_m
        self._near_m = near_m

    def see(
        self,
        tag: int,
        position_m: ArrayLike,
        facing_rad: float,
        distance_m: float,
        stamp_s: float,
        patch: NDArray[np.uint8],
    ) -> Victim:
        """Add a view of a victim and return what is now known about it.

        Args:
            tag: its number.
            position_m: (3,), map frame.
            facing_rad: the direction it faces, map frame.
            distance_m: distance from the camera.
            stamp_s: time of the image.
            patch: the part of the image around it.
        """
        position = np.asarray(position_m, float)
        victim = self.victims.get(tag)
        if victim is None:
            victim = self.victims[tag] = Victim(tag, position, facing_rad, stamp_s, stamp_s)
        victim.place(position, facing_rad, distance_m)
        victim.last_s = stamp_s
        if distance_m < victim.best_m:
            victim.best_m, victim.patch = distance_m, patch
        return victim

    def is_known_well(self, victim: Victim) -> bool:
        """Return whether enough is known about a victim to ask the operator."""
        enough = victim.views >= self._enough_views and victim.spread_m <= self._enough_spread_m
        return enough and victim.best_m <= self._near_m

    def state(self) -> list[dict[str, Any]]:
        """Return all victims as plain data."""
        return [{**vars(victim), "state": int(victim.state)} for victim in self.victims.values()]

    def restore(self, state: Sequence[Mapping[str, Any]]) -> None:
        """Restore the data that `state` returned."""
        for entry in state:
            victim = Victim(**{**entry, "state": VictimState(entry["state"])})
            self.victims[victim.tag] = victim
