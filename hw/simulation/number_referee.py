"""Judges visits to numbered boards by the true poses of robot and boards."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from robbie_robots.hw.pose import Pose, wrapped
from robbie_robots.hw.simulation.arena import Arena

NEAR_M = 1.5
IN_FRONT_RAD = math.radians(60)


@dataclass(frozen=True)
class Visit:
    """What the robot called a visit to a digit.

    Attributes:
        digit: the digit that it said.
        at_s: when it said so.
        distance_m: from the middle of the robot to the post of that digit; inf if there is no such digit.
        aside_rad: how far the robot is beside the direction in which the board can be read.
        is_in_order: whether this digit was the next one.
    """

    digit: int
    at_s: float
    distance_m: float
    aside_rad: float
    is_in_order: bool

    @property
    def counts(self) -> bool:
        """Return whether the robot stood near enough in front of the right board."""
        return self.is_in_order and self.distance_m <= NEAR_M and abs(self.aside_rad) <= IN_FRONT_RAD


def wanted_order(arena: Arena) -> list[int]:
    """Return the digits in the order of the visits: that of the sheet, otherwise ascending."""
    if arena.sheet is not None:
        return [int(digit) for digit in arena.sheet.text]
    return sorted(sign.digit for sign in arena.numbers if sign.digit is not None)


def judge(arena: Arena, before: Sequence[Visit], digit: int, robot: Pose, at_s: float) -> Visit:
    """Judge one visit.

    Args:
        arena: the true ground.
        before: the visits before this one.
        digit: what the robot says it has reached.
        robot: the robot's true pose, arena frame.
        at_s: the time.
    """
    order = wanted_order(arena)
    is_in_order = len(before) < len(order) and order[len(before)] == digit
    for sign in arena.numbers:
        if sign.digit == digit:
            x, y = robot.x_m - sign.x_m, robot.y_m - sign.y_m
            aside_rad = wrapped(math.atan2(y, x) - sign.facing_rad)
            return Visit(digit, at_s, math.hypot(x, y), aside_rad, is_in_order)
    return Visit(digit, at_s, math.inf, math.pi, is_in_order)
