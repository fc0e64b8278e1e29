"""The contents of an arena besides walls: victims and signs on the walls, and temporary obstacles."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from hw.simulation.box_segments import box_segments


class VictimKind(StrEnum):
    """How a victim appears."""

    STILL = "still"
    """Warm and motionless."""
    MOVING = "moving"
    """Warm and waving."""
    COLD = "cold"
    """A doll at the wall's temperature."""


class SignKind(StrEnum):
    """The danger that a hazard sign warns of; each kind has its own colour, like transport placards."""

    EXPLOSIVE = "explosive"
    FLAMMABLE_GAS = "flammable_gas"
    NON_FLAMMABLE_GAS = "non_flammable_gas"
    DANGEROUS_WHEN_WET = "dangerous_when_wet"
    OXIDIZER = "oxidizer"
    TOXIC = "toxic"


@dataclass(frozen=True)
class WallSpot:
    """A place on a wall, arena frame.

    Attributes:
        x_m: x of the place.
        y_m: y of the place.
        height_m: height above the floor.
        facing_rad: direction of the wall's normal, into the room.
    """

    x_m: float
    y_m: float
    height_m: float
    facing_rad: float


@dataclass(frozen=True)
class Victim:
    """A doll in front of a wall, with a tag on its chest.

    Attributes:
        tag: number of the tag (ArUco, dictionary 4x4_50).
        kind: how it appears.
        spot: the middle of its tag.
    """

    tag: int
    kind: VictimKind
    spot: WallSpot


@dataclass(frozen=True)
class HazardSign:
    """A sign on a wall; `spot` is its middle."""

    kind: SignKind
    spot: WallSpot


@dataclass(frozen=True)
class AppearingObstacle:
    """A temporary obstacle: a circle or a box.

    Attributes:
        shape_m: x, y, radius; or the two opposite corners of a box.
        from_s: when it appears, since the start of the simulation.
        until_s: when it disappears.
    """

    shape_m: tuple[float, ...]
    from_s: float
    until_s: float = math.inf

    @property
    def circles(self) -> NDArray[np.float64]:
        """Return (0 or 1, 3), m: x, y, radius."""
        return np.array([self.shape_m] if len(self.shape_m) == 3 else [], np.float64).reshape(-1, 3)

    @property
    def segments(self) -> NDArray[np.float64]:
        """Return (0 or 4, 4), m: x1, y1, x2, y2 of each side."""
        return box_segments(np.array([self.shape_m] if len(self.shape_m) == 4 else []).reshape(-1, 4))

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Return how far a point is from the obstacle; not positive within it."""
        if len(self.shape_m) == 3:
            x, y, radius = self.shape_m
            return math.hypot(x_m - x, y_m - y) - radius
        x1, y1, x2, y2 = self.shape_m
        beside_x = abs(x_m - (x1 + x2) / 2) - abs(x2 - x1) / 2
        beside_y = abs(y_m - (y1 + y2) / 2) - abs(y2 - y1) / 2
        return math.hypot(max(beside_x, 0.0), max(beside_y, 0.0))
