"""The contents of an arena besides walls: victims and signs, boards, temporary obstacles, people."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from strenum import StrEnum

from robbie_robots.hw.simulation.box_segments import box_segments

POST_RADIUS_M = 0.05
"""Radius of the posts that carry boards."""

Colour = tuple[int, int, int]
"""Red, green, blue; 0 to 255."""


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


class BoardFont(StrEnum):
    """The fonts of boards. Where one is not installed, the font within Pillow takes its place."""

    SANS = "DejaVuSans"
    SANS_BOLD = "DejaVuSans-Bold"
    SERIF = "DejaVuSerif"
    MONO = "DejaVuSansMono"
    GROTESQUE = "LiberationSans-Regular"
    ROMAN_BOLD = "LiberationSerif-Bold"
    PILLOW = "Pillow"


class Figure(StrEnum):
    """What a board may show besides digits and letters."""

    ARROW_LEFT = "arrow_left"
    ARROW_RIGHT = "arrow_right"
    ARROW_UP = "arrow_up"
    CROSS = "cross"
    RING = "ring"
    STAR = "star"
    TRIANGLE = "triangle"


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
class ArenaVictim:
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
class NumberSign:
    """A board on a post, which shows a digit or something else; its back shows nothing.

    Attributes:
        text: one character, or a `Figure`.
        x_m: x of the post.
        y_m: y of the post.
        facing_rad: the direction in which the board can be read.
        height_m: height of the board's middle above the ground.
        edge_m: edge of the board.
        font: font of the character.
        light: brightness, 1 in full light.
        shadow: share of the board on which a shadow falls.
    """

    text: str
    x_m: float
    y_m: float
    facing_rad: float
    height_m: float = 0.75
    edge_m: float = 0.45
    font: BoardFont = BoardFont.SANS
    light: float = 1.0
    shadow: float = 0.0

    @property
    def digit(self) -> int | None:
        """Return the digit that it shows; None if it shows something else."""
        return int(self.text) if self.text.isascii() and self.text.isdigit() else None

    @property
    def front(self) -> WallSpot:
        """Return the middle of the board's front."""
        return self._beside(0.0)

    @property
    def back(self) -> WallSpot:
        """Return the middle of the board's back."""
        return self._beside(math.pi)

    def _beside(self, turn_rad: float) -> WallSpot:
        facing_rad = self.facing_rad + turn_rad
        x_m = self.x_m + POST_RADIUS_M * math.cos(facing_rad)
        y_m = self.y_m + POST_RADIUS_M * math.sin(facing_rad)
        return WallSpot(x_m, y_m, self.height_m, facing_rad)


@dataclass(frozen=True)
class Sheet:
    """A sheet of paper with digits, which somebody holds up until the robot drives; no laser sees it.

    Attributes:
        text: the digits.
        spot: its middle.
        height_m: height of the paper.
    """

    text: str
    spot: WallSpot
    height_m: float = 0.18


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


@dataclass(frozen=True)
class Table:
    """A table that is closed down to the floor, such as a sideboard; the laser sees its sides.

    Attributes:
        name: its name.
        corners_m: two opposite corners: x1, y1, x2, y2.
        height_m: height of its top.
    """

    name: str
    corners_m: tuple[float, float, float, float]
    height_m: float

    def is_below(self, x_m: float, y_m: float, margin_m: float = 0.0) -> bool:
        """Return whether a place lies within its sides, this far from the edge."""
        x1, y1, x2, y2 = self.corners_m
        beside_x = abs(x_m - (x1 + x2) / 2) - abs(x2 - x1) / 2
        beside_y = abs(y_m - (y1 + y2) / 2) - abs(y2 - y1) / 2
        return max(beside_x, beside_y) <= -margin_m


@dataclass(frozen=True)
class StandingObject:
    """An object that stands on a table.

    Attributes:
        name: its name.
        size_m: extent in x, y and z before it is turned; the x and y of a round one are its diameter.
        is_round: whether it is an upright cylinder; otherwise it is a box.
        x_m: x of its middle.
        y_m: y of its middle.
        base_m: height of the table on which it stands.
        yaw_rad: how far it is turned.
        print_seed: seed of what is printed on it; None: it is plain.
    """

    name: str
    size_m: tuple[float, float, float]
    is_round: bool
    x_m: float
    y_m: float
    base_m: float
    yaw_rad: float = 0.0
    print_seed: int | None = None


@dataclass(frozen=True)
class ArenaPerson:
    """Somebody who walks along a way.

    Attributes:
        name: the person's name.
        way: x (m), y (m) and how long the person stands there (s), of each way point; arena frame.
        speed_m_per_s: speed of walking.
        from_s: the person stands at the first point until this time of the simulation.
        is_loop: whether the first point follows the last one; otherwise the person walks back.
        crosses: whether the person, at each way point, waits until it can pass close behind the first person.
        shirt: its colour.
        trousers: their colour.
    """

    name: str
    way: tuple[tuple[float, float, float], ...]
    speed_m_per_s: float = 0.6
    from_s: float = 0.0
    is_loop: bool = False
    crosses: bool = False
    shirt: Colour = (190, 40, 40)
    trousers: Colour = (50, 60, 110)
