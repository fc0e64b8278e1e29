"""Walking people in a simulated world: where they go, how their legs swing, and how they look."""

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from robbie_robots.hw.pose import Pose, wrapped
from robbie_robots.hw.simulation.arena_contents import ArenaPerson, Colour, WallSpot
from robbie_robots.hw.simulation.doors import Doors
from robbie_robots.hw.simulation.hanging import Hanging
from robbie_robots.hw.simulation.texture import Texture

Array = NDArray[np.float64]

STEP_S = 0.05
LEG_RADIUS_M = 0.06
"""Radius of a leg at the height of the laser."""
LEG_ASIDE_M = 0.09
"""Distance of each leg's middle from the person's middle, to the side."""
STRIDE_M = 0.9
"""Way of a person during a whole cycle of two steps."""
START_S = 0.4
"""Time in which a person begins to walk with whole strides, or puts the feet together."""
TURN_RAD_PER_S = 3.0
ROBOT_APART_M, OTHER_APART_M = 0.65, 0.6
"""A person stops when the middle of the robot, or of a person before it in the list, is this near ahead."""
AHEAD_COS = 0.5
PATIENCE_S = 3.0
"""A person whose way was blocked for this time walks back."""
BEHIND_M = 0.7
"""A person who crosses the way of the first person passes this far behind."""
HEIGHT_M, TEXEL_M = 1.72, 0.01
SKIN, HAIR, SHOES = (228, 180, 150), (70, 50, 40), (40, 38, 36)
STRIPE = 0.85
"""Brightness of the darker stripes of a shirt."""
HEAD_M = 0.27
"""Height of a head on a picture, from chin to hair."""
PICTURE_S = 3.0
"""Time after which a person with several pictures shows the next one."""
PICTURES = (".jpg", ".jpeg", ".png")
MAX_PICTURE_PX = 2000


class FacesError(ValueError):
    """A folder of faces cannot be used; the message names the file and what was expected."""


class PersonState(NamedTuple):
    """Where a person is on its way.

    Attributes:
        x_m: x of the person's middle, arena frame.
        y_m: y of the person's middle.
        heading_rad: direction in which the person looks.
        phase_rad: of the cycle of two steps; 0: the left foot is in front.
        stride: 0: the feet are together; 1: whole strides.
        next_point: index of the way point to which the person walks.
        direction: 1, or -1 on the way back.
        wait_until_s: the person stands until this time of the simulation.
        blocked_s: for how long the way has been blocked.
    """

    x_m: float
    y_m: float
    heading_rad: float
    phase_rad: float = 0.0
    stride: float = 0.0
    next_point: int = 1
    direction: int = 1
    wait_until_s: float = 0.0
    blocked_s: float = 0.0

    @property
    def shown(self) -> tuple[float, float, float, float, float]:
        """Return x (m), y (m), heading (rad), phase (rad) and stride: what sensors need."""
        return self.x_m, self.y_m, self.heading_rad, self.phase_rad, self.stride


def leg_circles(shown: Array) -> Array:
    """Return the legs of people as circles.

    In each half of a cycle, one foot stands on the ground while the body passes over it, and the other one
    swings from back to front.

    Args:
        shown: (P, 5), as `PersonState.shown`.

    Returns:
        (2 P, 3), m: x, y, radius.
    """
    shown = np.asarray(shown, np.float64).reshape(-1, 5)
    x, y, heading, phase, stride = shown.T
    cos, sin = np.cos(heading), np.sin(heading)
    legs = []
    for side, shift in ((1.0, 0.0), (-1.0, math.pi)):
        cycle = (phase + shift) % math.tau
        # Standing: from front to back as fast as the body moves. Swinging: back to the front, smoothly.
        standing = STRIDE_M * (0.25 - 0.5 * cycle / math.pi)
        swinging = -STRIDE_M * 0.25 * np.cos(cycle - math.pi)
        ahead = stride * np.where(cycle < math.pi, standing, swinging)
        aside = side * LEG_ASIDE_M
        legs.append(np.column_stack([x + cos * ahead - sin * aside, y + sin * ahead + cos * aside]))
    middles = np.concatenate(legs)
    return np.column_stack([middles, np.full(len(middles), LEG_RADIUS_M)])


class WalkingPeople:
    """Moves people along their ways, in fixed steps of time.

    A person stops in front of the robot and in front of people earlier in the list; the first one stops for
    the robot only. So let ways cross; do not let them meet head on.

    Args:
        persons: the people and their ways.
        states: where they are; by default at the beginning of their ways.
        doors: doors that they open, and wait for.
    """

    def __init__(
        self,
        persons: Sequence[ArenaPerson],
        states: Sequence[Sequence[float]] = (),
        doors: Doors | None = None,
    ) -> None:
        self._persons = tuple(persons)
        self._doors = Doors(()) if doors is None else doors
        given = [_state_of(one) for one in states]
        self.states = given if len(given) == len(self._persons) else [_first(one) for one in self._persons]
        self._steps = -1

    @property
    def shown(self) -> Array:
        """Return (P, 5), as `PersonState.shown`."""
        return np.array([state.shown for state in self.states]).reshape(-1, 5)

    def walk_until(self, elapsed_s: float, robot: Pose) -> None:
        """Move everybody until a time.

        Args:
            elapsed_s: since the start of the simulation.
            robot: where the robot is, arena frame.
        """
        steps = int(elapsed_s / STEP_S + 1e-6)
        if self._steps < 0:  # a new process continues at the time at which the last one ended
            self._steps = steps
        while self._steps < steps:
            self._steps += 1
            for index in range(len(self._persons)):
                self.states[index] = self._moved(index, self._steps * STEP_S, robot)

    def _moved(self, index: int, now_s: float, robot: Pose) -> PersonState:
        person, state = self._persons[index], self.states[index]
        x, y, _ = person.way[state.next_point]
        left_m = math.dist((x, y), state[:2])
        bearing = math.atan2(y - state.y_m, x - state.x_m)
        if now_s < max(person.from_s, state.wait_until_s) or not self._may_start(index, left_m, bearing):
            return _standing(state, 0.0)
        self._doors.open_for(state[:2], (x, y))
        if self._doors.blocks(state[:2], (x, y)) or self._is_blocked(index, bearing, robot):
            return self._stopped(person, state)
        way_m = person.speed_m_per_s * STEP_S
        turn = wrapped(bearing - state.heading_rad)
        turn = math.copysign(min(abs(turn), TURN_RAD_PER_S * STEP_S), turn)
        walking = state._replace(
            heading_rad=wrapped(state.heading_rad + turn),
            phase_rad=(state.phase_rad + math.tau * way_m / STRIDE_M) % math.tau,
            stride=min(1.0, state.stride + STEP_S / START_S),
            blocked_s=0.0,
        )
        if left_m <= way_m:
            return _arrived(person, walking, now_s)
        step = way_m / left_m
        return walking._replace(
            x_m=state.x_m + step * (x - state.x_m), y_m=state.y_m + step * (y - state.y_m)
        )

    def _stopped(self, person: ArenaPerson, state: PersonState) -> PersonState:
        """Return a person whose way is blocked; after a while, the person turns back."""
        if state.blocked_s < PATIENCE_S:
            return _standing(state, state.blocked_s + STEP_S)
        return _standing(_turned_back(person, state), 0.0)

    def _is_blocked(self, index: int, bearing: float, robot: Pose) -> bool:
        state = self.states[index]
        near = [(robot[:2], ROBOT_APART_M), *((one[:2], OTHER_APART_M) for one in self.states[:index])]
        for (x, y), apart_m in near:
            away_m = math.dist((x, y), state[:2])
            ahead = (x - state.x_m) * math.cos(bearing) + (y - state.y_m) * math.sin(bearing)
            if away_m < apart_m and ahead > AHEAD_COS * away_m:
                return True
        return False

    def _may_start(self, index: int, left_m: float, bearing: float) -> bool:
        """Return whether a person may walk on: one who crosses waits for the first person to pass."""
        person, state = self._persons[index], self.states[index]
        at_point = any(math.dist(state[:2], point[:2]) < 1e-6 for point in person.way)
        if not person.crosses or index == 0 or not at_point:
            return True
        first, leader = self.states[0], self._persons[0]
        if first.stride < 1.0:
            return False
        speed = leader.speed_m_per_s
        goal_x, goal_y, _ = leader.way[first.next_point]
        course = math.atan2(goal_y - first.y_m, goal_x - first.x_m)
        # Where the two straight ways meet: own way a, the first person's time t until then.
        unit, velocity = (math.cos(bearing), math.sin(bearing)), (math.cos(course), math.sin(course))
        area = unit[0] * velocity[1] - unit[1] * velocity[0]
        if abs(area) < 0.3:
            return False
        apart = (first.x_m - state.x_m, first.y_m - state.y_m)
        a = (apart[0] * velocity[1] - apart[1] * velocity[0]) / area
        b = (apart[0] * unit[1] - apart[1] * unit[0]) / area
        if not 0.0 < a < left_m or b > math.dist((goal_x, goal_y), first[:2]):
            return False
        spare_s = a / person.speed_m_per_s - (b + BEHIND_M) / speed
        return 0.0 <= spare_s < 0.5


def _first(person: ArenaPerson) -> PersonState:
    (x, y, _), (next_x, next_y, _) = person.way[:2]
    return PersonState(x, y, math.atan2(next_y - y, next_x - x))


def _state_of(values: Sequence[float]) -> PersonState:
    x, y, heading, phase, stride, point, direction, wait_s, blocked_s = values
    return PersonState(x, y, heading, phase, stride, int(point), int(direction), wait_s, blocked_s)


def _standing(state: PersonState, blocked_s: float) -> PersonState:
    return state._replace(stride=max(0.0, state.stride - STEP_S / START_S), blocked_s=blocked_s)


def _turned_back(person: ArenaPerson, state: PersonState) -> PersonState:
    count = len(person.way)
    back = state.next_point - state.direction
    back = back % count if person.is_loop else max(0, min(count - 1, back))
    return state._replace(direction=-state.direction, next_point=back)


def _arrived(person: ArenaPerson, state: PersonState, now_s: float) -> PersonState:
    """Return a person at its way point, with the next one to walk to."""
    x, y, pause_s = person.way[state.next_point]
    count, direction = len(person.way), state.direction
    following = state.next_point + direction
    if person.is_loop:
        following %= count
    elif not 0 <= following < count:
        direction = -direction
        following = state.next_point + direction
    wait_s = now_s + pause_s if pause_s > 0 else 0.0
    return state._replace(
        x_m=x, y_m=y, next_point=following, direction=direction, wait_until_s=wait_s, blocked_s=0.0
    )


def person_hanging(person: ArenaPerson, shown: Sequence[float], eye: Pose) -> Hanging:
    """Return the picture of a person, upright and turned to the eye.

    Args:
        person: the person.
        shown: as `PersonState.shown`.
        eye: the eye, arena frame.
    """
    x, y = float(shown[0]), float(shown[1])
    facing = math.atan2(eye.y_m - y, eye.x_m - x)
    return Hanging(WallSpot(x, y, 0.0, facing), _figure(person.shirt, person.trousers))


def head_hanging(head: Texture, shown: Sequence[float], eye: Pose) -> Hanging:
    """Return the picture of a person's head, turned to the eye: it covers the head of `person_hanging`.

    Args:
        head: one of those of `read_heads`.
        shown: as `PersonState.shown`.
        eye: the eye, arena frame.
    """
    x, y = float(shown[0]), float(shown[1])
    facing = math.atan2(eye.y_m - y, eye.x_m - x)
    return Hanging(WallSpot(x, y, HEIGHT_M, facing), head)


def read_heads(folder: Path, names: Sequence[str]) -> dict[str, list[Texture]]:
    """Read the pictures of people's heads.

    Args:
        folder: with `NAME.jpg` (or `.png`), or `NAME_1.jpg`, `NAME_2.jpg` and so on, which the person shows
            in turns. Each shows a head from the front, and nothing else, from chin to hair.
        names: of the people; those without a picture are left out.

    Raises:
        FacesError: there is no such folder, or a file in it is not a picture.
    """
    if not folder.is_dir():
        raise FacesError(f"{folder}: there is no such folder")
    heads: dict[str, list[Texture]] = {}
    for file in sorted(folder.iterdir()):
        name = file.stem.split("_")[0]
        if file.suffix.lower() in PICTURES and name in names:
            heads.setdefault(name, []).append(_head(file))
    return heads


def _head(file: Path) -> Texture:
    try:
        with Image.open(file) as picture:
            if max(picture.size) > MAX_PICTURE_PX:
                raise FacesError(f"{file}: a picture has at most {MAX_PICTURE_PX} rows and columns")
            values = np.asarray(picture.convert("RGB"))
    except (OSError, UnidentifiedImageError) as error:
        raise FacesError(f"{file}: cannot be read as a picture: {error}") from error
    return Texture(values, np.ones(values.shape[:2], np.bool_), HEAD_M / len(values), 0.0)


@cache
def _figure(shirt: Colour, trousers: Colour) -> Texture:
    """Return a figure with head, shirt with stripes, arms, trousers and shoes; its feet are at the spot."""
    rows, columns = round(HEIGHT_M / TEXEL_M), 56
    row, column = np.mgrid[:rows, :columns] + 0.5
    aside = np.abs(column - columns / 2)
    head = np.hypot((row - 14) / 13, aside / 10) < 1
    body = (row > 28) & (row < 92) & (aside < 18 + 0.04 * (row - 28))
    arms = (row > 32) & (row < 98) & (aside >= 18) & (aside < 27)
    legs = (row >= 88) & (aside > 1.5) & (aside < 17 - 0.05 * (row - 88))
    values = np.zeros((rows, columns, 3), np.uint8)
    dark = (np.floor(row / 7).astype(int) % 2 == 1)[:, :, None]
    values[:] = np.where(dark, STRIPE * np.array(shirt), shirt)
    values[legs] = trousers
    values[legs & (row > rows - 8)] = SHOES
    values[head | (arms & (row > 88))] = SKIN
    values[head & (row < 9)] = HAIR
    return Texture(values, head | body | arms | legs, TEXEL_M, float(rows))
