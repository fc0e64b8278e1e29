"""Where the robot drives to: in front of a sign, to where it can look at posts, or to the end of the map.

A place to look from is worth what the camera has not yet seen of the posts around it, for each metre of way
(Gonzalez-Banos and Latombe, "Navigation strategies for exploring indoor environments", IJRR 2002).
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robbie_robots.workers.exploration.drivable_ground import DrivableGround
from robbie_robots.workers.exploration.frontiers import find_frontiers
from robbie_robots.workers.maps.navigation_grid import OCCUPIED_PERCENT
from robbie_robots.workers.numbers.mission_states import NumbersSettings, NumbersState
from robbie_robots.workers.numbers.sign_map import LOOK_RAD, SECTORS, covered, sector_rad
from robbie_robots.workers.planar_pose import wrap_angle

Points = NDArray[np.float64]

SAME_M = 0.4
NEAR_FRONTIER_M = 0.6
ASIDE_M_PER_RAD = 1.5
"""The robot drives this much farther to stand straight in front of a sign."""
SLANT_RAD = 0.9
"""A board whose front is known is looked at from at most this far beside it."""
CONFIRM_RAD = 0.27
STEP_M = 0.2
"""Places to look from are this far apart."""
BOARD_M, BEFORE_M = 0.1, 0.3
"""Nothing may be nearer than the first to the line of sight, up to the second before the post."""
LOOK_M = 2.0
"""A stop to look costs as much time as this way."""
FRONTIER_GAIN, EXPLORE_LATER_M = 2.0, 3.0
MAX_LOOKS, MAX_PAN_RAD = 4, 2.4


@dataclass(frozen=True)
class SignReport:
    """What is known about a post and its sign.

    Attributes:
        xy_m: its place, map frame.
        facing_rad: the direction in which it can be read; NaN if it has not been read.
        digit: what it shows; None as long as that is not sure, or if it is something else.
        is_open: whether it may still turn out to carry a digit.
        searched: bit k is set if a board would have been read that faces in the direction k of `sector_rad`.
        likely: the digit that was read most often, even if it is not sure; None: none was read.
        views: number of images in which that digit was read.
    """

    xy_m: tuple[float, float]
    facing_rad: float
    digit: int | None
    is_open: bool
    searched: int
    likely: int | None = None
    views: int = 0


@dataclass(frozen=True)
class PostWish:
    """What the robot wants to see of a post.

    Attributes:
        xy_m: the post, m, map frame.
        bits: bit k is set if it wants to see a board that faces in the direction k of `sector_rad`.
        worth: of each bit.
        facing_rad: in which direction the board can be read; NaN if that is not known.
    """

    xy_m: tuple[float, float]
    bits: int
    worth: float = 1.0
    facing_rad: float = math.nan

    @property
    def reach_rad(self) -> float:
        """Return how far beside it a look covers; little if the digit must be read from elsewhere, too."""
        return LOOK_RAD if math.isnan(self.facing_rad) else CONFIRM_RAD

    def seen_from(self, place: Sequence[float] | Points) -> int:
        """Return which of its bits a look from a place covers, whatever stands between."""
        direction_rad = math.atan2(float(place[1]) - self.xy_m[1], float(place[0]) - self.xy_m[0])
        beside_rad = math.remainder(direction_rad - self.facing_rad, math.tau)
        return 0 if abs(beside_rad) > SLANT_RAD else self.bits & covered(direction_rad, self.reach_rad)


@dataclass(frozen=True)
class Look:
    """One look at a post: where the post is, and the place of the look, m, map frame."""

    xy_m: tuple[float, float]
    from_xy_m: tuple[float, float]


@dataclass(frozen=True)
class NumbersTarget:
    """A place to drive to.

    Attributes:
        state: what the robot does on the way.
        goal: `(3,)`, x, y (m) and heading (rad), map frame.
        about_xy_m: why it drives there, m, map frame: a sign, a post, or a frontier.
        looks: what to look at from there, one after the other.
        value: what it is worth for each metre of way.
    """

    state: NumbersState
    goal: Points
    about_xy_m: tuple[float, float]
    looks: tuple[Look, ...] = ()
    value: float = 0.0

    def is_like(self, other: "NumbersTarget") -> bool:
        """Return whether two targets are the same, except for small changes of the map."""
        near = math.dist(self.about_xy_m, other.about_xy_m) <= SAME_M
        return near and self.state is other.state


class NumbersTargets:
    """Finds targets on one map.

    Args:
        ground: the map.
        pose: the robot's pose.
        settings: distances.
    """

    def __init__(self, ground: DrivableGround, pose: Points, settings: NumbersSettings) -> None:
        self._ground = ground
        self._settings = settings
        ways = ground.ways_from(pose)
        self.can_drive = ways is not None
        """Whether the robot stands on drivable ground."""
        self._ways_m = np.full(ground.goals.shape, np.inf)
        if ways is not None:
            self._ways_m = np.where(ground.goals, ways.cost_m, np.inf)
        self._cells = np.argwhere(np.isfinite(self._ways_m))
        self._places = ground.grid.middles_m(self._cells)
        around = max(1, round(BOARD_M / ground.resolution_m))
        self._hides = ndimage.binary_dilation(ground.cells >= OCCUPIED_PERCENT, iterations=around)

    def front_of(self, sign: SignReport, avoided: Sequence[Points]) -> NumbersTarget | None:
        """Return where to stop in front of a sign; None if the robot cannot drive there.

        Args:
            sign: the sign.
            avoided: goals in front of it that could not be reached.
        """
        stop_rad = math.pi if math.isnan(sign.facing_rad) else self._settings.stop_rad
        near_m, far_m = self._settings.stop_m
        distance_m = np.hypot(*(self._places - sign.xy_m).T)
        aside_rad = aside_of(sign, self._places)
        good = (distance_m >= near_m) & (distance_m <= far_m) & (aside_rad <= stop_rad)
        good &= self._are_away(self._places, avoided, SAME_M / 2)
        if not good.any():
            return None
        cost_m = self._ways_m[tuple(self._cells[good].T)] + ASIDE_M_PER_RAD * aside_rad[good]
        place = self._places[good][int(np.argmin(cost_m))]
        return NumbersTarget(NumbersState.APPROACH, _facing(place, sign.xy_m), sign.xy_m)

    def best_view(
        self, wishes: Iterable[PostWish], between_m: tuple[float, float], avoided: Sequence[Points]
    ) -> NumbersTarget | None:
        """Return the best place to look at posts from; None if there is nothing to see from anywhere.

        Args:
            wishes: what the robot wants to see.
            between_m: distances from which it looks.
            avoided: goals that could not be reached.
        """
        wishes = list(wishes)
        step = max(1, round(STEP_M / self._ground.resolution_m))
        chosen = (self._cells % step == 0).all(axis=1)
        if len(self._cells):
            chosen[int(np.argmin(self._ways_m[tuple(self._cells.T)]))] = True  # where the robot stands
        chosen &= self._are_away(self._places, avoided, SAME_M)
        places, ways_m = self._places[chosen], self._ways_m[tuple(self._cells[chosen].T)]
        gains = np.zeros(len(places))
        for wish in wishes:
            gains += wish.worth * self._seen(places, wish, between_m)
        values = gains / (ways_m + LOOK_M)
        if not (values > 0).any():
            return None
        best = int(np.argmax(values))
        return self._view_from(places[best], wishes, between_m, float(values[best]))

    def view_again(
        self, old: NumbersTarget, wishes: Iterable[PostWish], between_m: tuple[float, float]
    ) -> NumbersTarget | None:
        """Return an earlier view with its present value; None if nothing is left to see there."""
        cell = self._ground.grid.nearest(np.isfinite(self._ways_m), old.goal, SAME_M)
        if cell is None:
            return None
        wishes, place = list(wishes), old.goal[:2]
        gain = sum(wish.worth * float(self._seen(place[None], wish, between_m)[0]) for wish in wishes)
        if not gain:
            return None
        view = self._view_from(place, wishes, between_m, gain / (float(self._ways_m[cell]) + LOOK_M))
        return NumbersTarget(view.state, old.goal, view.about_xy_m, view.looks, view.value)

    def frontiers(self) -> Iterator[NumbersTarget]:
        """Return where the map ends."""
        grid = self._ground.grid
        for frontier in find_frontiers(grid, self._settings.min_frontier_m):
            cell = grid.nearest(np.isfinite(self._ways_m), frontier.middle_xy_m, NEAR_FRONTIER_M)
            if cell is not None:
                x, y = frontier.middle_xy_m.tolist()
                value = FRONTIER_GAIN / (float(self._ways_m[cell]) + EXPLORE_LATER_M)
                yield NumbersTarget(
                    NumbersState.EXPLORE, _facing(grid.middles_m(cell), (x, y)), (x, y), (), value
                )

    def _seen(self, places: Points, wish: PostWish, between_m: tuple[float, float]) -> NDArray[np.int64]:
        """Return how many of a wish's bits a look from each place `(N, 2)` covers: `(N,)`."""
        offset = places - wish.xy_m
        distance_m = np.hypot(offset[:, 0], offset[:, 1])
        direction_rad = np.arctan2(offset[:, 1], offset[:, 0])
        count = np.zeros(len(places), np.int64)
        for number in range(SECTORS):
            if wish.bits >> number & 1:
                count += np.abs(wrap_angle(direction_rad - sector_rad(number))) <= wish.reach_rad
        good = (count > 0) & (distance_m >= between_m[0]) & (distance_m <= between_m[1])
        if not math.isnan(wish.facing_rad):
            good &= np.abs(wrap_angle(direction_rad - wish.facing_rad)) <= SLANT_RAD
        good[good] = self._is_in_sight(places[good], wish.xy_m)
        return np.where(good, count, 0)

    def _is_in_sight(self, places: Points, post_m: tuple[float, float]) -> NDArray[np.bool_]:
        """Return from which places `(N, 2)` a board on a post can be seen: nothing stands between."""
        if len(places) == 0:
            return np.zeros(0, bool)
        offset = np.asarray(post_m) - places
        distance_m = np.hypot(offset[:, 0], offset[:, 1])
        steps = int(distance_m.max() / self._ground.resolution_m) + 2
        along_m = np.linspace(0.0, 1.0, steps)[:, None] * np.maximum(distance_m - BEFORE_M, 0.0)
        way = places + along_m[:, :, None] * (offset / distance_m[:, None])
        column, row = (
            np.floor((way - self._ground.corner_xy_m) / self._ground.resolution_m)
            .astype(int)
            .transpose(2, 0, 1)
        )
        height, width = self._hides.shape
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        hit = self._hides[np.where(inside, row, 0), np.where(inside, column, 0)] & inside
        is_hidden: NDArray[np.bool_] = hit.any(axis=0)
        return ~is_hidden

    def _view_from(
        self, place: Points, wishes: Sequence[PostWish], between_m: tuple[float, float], value: float
    ) -> NumbersTarget:
        """Return a place with all looks that a camera with a limited pan can take from there."""
        seen = [wish for wish in wishes if self._seen(place[None], wish, between_m)[0]]
        seen.sort(key=lambda wish: -wish.worth * wish.seen_from(place).bit_count())
        bearings = [math.atan2(wish.xy_m[1] - place[1], wish.xy_m[0] - place[0]) for wish in seen]
        heading_rad = bearings[0]
        looks: list[Look] = []
        x, y = place.tolist()
        for wish, bearing_rad in zip(seen, bearings, strict=True):
            if abs(math.remainder(bearing_rad - heading_rad, math.tau)) <= MAX_PAN_RAD:
                looks.append(Look(wish.xy_m, (x, y)))
        goal = np.array([x, y, heading_rad])
        return NumbersTarget(NumbersState.SEARCH, goal, seen[0].xy_m, tuple(looks[:MAX_LOOKS]), value)

    @staticmethod
    def _are_away(places: Points, avoided: Sequence[Points], by_m: float) -> NDArray[np.bool_]:
        away = np.ones(len(places), bool)
        for place in avoided:
            away &= np.hypot(*(places - place[:2]).T) > by_m
        return away


def aside_of(sign: SignReport, places: Points) -> Points:
    """Return how far places `(N, 2)` are beside the front of a sign, rad: `(N,)`; 0 if it is not known."""
    if math.isnan(sign.facing_rad):
        return np.zeros(len(places))
    offset = places - sign.xy_m
    return np.abs(wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - sign.facing_rad))


def _facing(place: Points, about: tuple[float, float]) -> Points:
    """Return the pose at a place that faces another."""
    dx, dy = (np.asarray(about) - place).tolist()
    return np.array([*place, math.atan2(dy, dx)])
