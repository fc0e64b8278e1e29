"""Doors of a simulated world: they turn on hinges, and stop before they touch somebody."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import Pose

Array = NDArray[np.float64]

STEP_S = 0.05
TURN_RAD_PER_S = 1.2
PERSON_RADIUS_M = 0.25
BEFORE_M = 0.4
"""A person whose way leads through a closed door opens it, and waits, this far outside the leaf's reach."""


@dataclass(frozen=True)
class Door:
    """A door with one leaf; cameras and lasers see the leaf as a thin wall.

    Attributes:
        name: its name.
        hinge_m: x and y of the hinge, arena frame.
        edge_m: x and y of the leaf's other edge while the door is closed.
        opens_rad: how far the leaf turns until the door is open, counter-clockwise if positive.
        is_open: whether it is open at the start.
    """

    name: str
    hinge_m: tuple[float, float]
    edge_m: tuple[float, float]
    opens_rad: float
    is_open: bool = False

    @property
    def width_m(self) -> float:
        """Return the length of the leaf."""
        return math.dist(self.hinge_m, self.edge_m)

    @property
    def middle_m(self) -> tuple[float, float]:
        """Return x and y of the middle of the closed leaf."""
        return (self.hinge_m[0] + self.edge_m[0]) / 2, (self.hinge_m[1] + self.edge_m[1]) / 2

    def leaf(self, opened_rad: float) -> Array:
        """Return the leaf: (4,), m: x1, y1, x2, y2.

        Args:
            opened_rad: how far it is turned from where the door is closed.
        """
        x, y = self.hinge_m
        closed = math.atan2(self.edge_m[1] - y, self.edge_m[0] - x)
        along = closed + opened_rad
        return np.array([x, y, x + self.width_m * math.cos(along), y + self.width_m * math.sin(along)])

    def is_near(self, place_m: Sequence[float]) -> bool:
        """Return whether somebody at a place opens the door, or waits for it."""
        return math.dist(place_m[:2], self.middle_m) < self.width_m + BEFORE_M

    def is_between(self, one_m: Sequence[float], other_m: Sequence[float]) -> bool:
        """Return whether the straight way between two places leads through the door."""

        def side(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
            return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

        across = side(self.hinge_m, self.edge_m, one_m) * side(self.hinge_m, self.edge_m, other_m)
        along = side(one_m, other_m, self.hinge_m) * side(one_m, other_m, self.edge_m)
        return across < 0 and along < 0


class Doors:
    """Turns doors towards where they should be, in fixed steps of time.

    Args:
        doors: the doors.
        states: for each door how far it is open (rad), and 1 if it should be open, else 0; by default as at
            the start.
    """

    def __init__(self, doors: Sequence[Door], states: Sequence[Sequence[float]] = ()) -> None:
        self._doors = tuple(doors)
        if len(states) != len(self._doors):
            states = [(door.opens_rad * door.is_open, float(door.is_open)) for door in self._doors]
        self.opened_rad = [float(opened) for opened, _ in states]
        """How far each door is open."""
        self._wanted = [bool(wanted) for _, wanted in states]
        self._steps = -1

    @property
    def states(self) -> tuple[tuple[float, float], ...]:
        """Return what a new process needs to go on."""
        return tuple(zip(self.opened_rad, map(float, self._wanted), strict=True))

    @property
    def leaves(self) -> Array:
        """Return all leaves: (N, 4), m: x1, y1, x2, y2."""
        return door_leaves(self._doors, self.opened_rad)

    def want(self, name: str, *, is_open: bool) -> bool:
        """Open or close a door from now on. Return whether there is such a door."""
        found = [index for index, door in enumerate(self._doors) if door.name == name]
        for index in found:
            self._wanted[index] = is_open
        return bool(found)

    def open_for(self, place_m: Sequence[float], next_m: Sequence[float]) -> None:
        """Have a person open the doors that are near, and on the way to a place.

        Args:
            place_m: x and y of the person.
            next_m: x and y of the place to which the person walks.
        """
        for index, door in enumerate(self._doors):
            if door.is_near(place_m) and door.is_between(place_m, next_m):
                self._wanted[index] = True

    def blocks(self, place_m: Sequence[float], next_m: Sequence[float]) -> bool:
        """Return whether a person who walks to a place must wait for a door that is not open yet."""
        return any(
            self.opened_rad[index] != door.opens_rad
            and door.is_near(place_m)
            and door.is_between(place_m, next_m)
            for index, door in enumerate(self._doors)
        )

    def turn_until(
        self, elapsed_s: float, robot: Pose, robot_radius_m: float, people: Iterable[Sequence[float]]
    ) -> bool:
        """Turn the doors until a time. Return whether one has moved.

        Args:
            elapsed_s: since the start of the simulation.
            robot: where the robot is, arena frame.
            robot_radius_m: its radius; no leaf comes nearer to its middle.
            people: of each person x, y (m) and more, arena frame.
        """
        steps = int(elapsed_s / STEP_S + 1e-6)
        if self._steps < 0:  # a new process continues at the time at which the last one ended
            self._steps = steps
        due, self._steps = steps - self._steps, steps
        before = list(self.opened_rad)
        if due <= 0 or all(self._left_rad(index) == 0.0 for index in range(len(self._doors))):
            return False
        bodies = [(robot.x_m, robot.y_m, robot_radius_m), *((*one[:2], PERSON_RADIUS_M) for one in people)]
        for _ in range(due):
            self.opened_rad = [self._turned(index, bodies) for index in range(len(self._doors))]
        return self.opened_rad != before

    def _left_rad(self, index: int) -> float:
        """Return how far a door still has to turn."""
        return self._doors[index].opens_rad * self._wanted[index] - self.opened_rad[index]

    def _turned(self, index: int, bodies: Sequence[Sequence[float]]) -> float:
        """Return how far a door is open after a step; it stands still if that would touch somebody."""
        opened, left = self.opened_rad[index], self._left_rad(index)
        if abs(left) <= STEP_S * TURN_RAD_PER_S:
            there = self._doors[index].opens_rad * self._wanted[index]
        else:
            there = opened + math.copysign(STEP_S * TURN_RAD_PER_S, left)
        leaf = self._doors[index].leaf(there)
        return opened if any(_distance_m(leaf, x, y) < radius for x, y, radius in bodies) else there


def door_leaves(doors: Sequence[Door], opened_rad: Iterable[float]) -> Array:
    """Return the leaves of doors: (N, 4), m: x1, y1, x2, y2.

    Args:
        doors: the doors.
        opened_rad: how far each of them is open.
    """
    leaves = [door.leaf(opened) for door, opened in zip(doors, opened_rad, strict=True)]
    return np.array(leaves).reshape(-1, 4)


def _distance_m(leaf: Array, x_m: float, y_m: float) -> float:
    x1, y1, x2, y2 = leaf
    dx, dy = x2 - x1, y2 - y1
    along = ((x_m - x1) * dx + (y_m - y1) * dy) / (dx * dx + dy * dy)
    along = min(max(along, 0.0), 1.0)
    return math.hypot(x_m - x1 - along * dx, y_m - y1 - along * dy)
