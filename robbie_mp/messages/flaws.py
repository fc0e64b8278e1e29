"""What the rules of message types are made of; see `robbie_mp.messages.well_formed`."""

import math
from typing import NamedTuple

import numpy as np

MAX_POSITION_M = 1e7
"""Farther from the origin of any frame nothing is: UTM coordinates, and the whole Earth, lie within."""
MIN_CELL_M = 1e-4
MAX_CELL_M = 1e4
"""Edges of a grid's cells."""
MAX_MAGNITUDE = 1e9
"""Of numbers whose unit their type does not know."""


class Flaw(NamedTuple):
    """The first thing that is wrong with a message.

    Attributes:
        field: where: the names of fields and the numbers of elements, as in `poses[2].pose.position.x`.
        value: what is there.
        expected: what should be there.
    """

    field: str
    value: object
    expected: str


def beyond(message: object, limit: float, *names: str) -> Flaw | None:
    """Return the first of some numbers that is not finite, or whose magnitude is greater than a limit."""
    for name in names:
        value = getattr(message, name)
        if not -limit <= value <= limit:
            return Flaw(name, value, f"a finite number of at most {limit:g} either way")
    return None


def outside(message: object, low: float, high: float, *names: str, nan: bool = False) -> Flaw | None:
    """Return the first of some numbers that is not from `low` to `high`; NaN is allowed if `nan`."""
    for name in names:
        value = getattr(message, name)
        if not low <= value <= high and not (nan and math.isnan(value)):
            return Flaw(name, value, f"{low:g} to {high:g}{', or NaN if it is not known' if nan else ''}")
    return None


def nan_in(message: object, *names: str) -> Flaw | None:
    """Return the first of some numbers that is NaN, where infinity has a meaning."""
    for name in names:
        if math.isnan(value := getattr(message, name)):
            return Flaw(name, value, "a number")
    return None


def elements_beyond(message: object, limit: float, *names: str) -> Flaw | None:
    """Return the first element of some small arrays that is not finite, or beyond a limit."""
    for name in names:
        array = getattr(message, name)
        if len(array) and not (fits := np.abs(array) <= limit).all():
            index = int(np.argmin(fits))
            expected = f"a finite number of at most {limit:g} either way"
            return Flaw(f"{name}[{index}]", array[index].item(), expected)
    return None


def unlike_lengths(message: object, of: str, *names: str, or_empty: bool = False) -> Flaw | None:
    """Return the first of some sequences that is not as long as another; `or_empty`: nor empty."""
    length = len(getattr(message, of))
    for name in names:
        count = len(getattr(message, name))
        if count != length and not (or_empty and not count):
            none = ", or none" if or_empty else ""
            return Flaw(name, _Count(count), f"{length} elements, as in {of}{none}")
    return None


def wrong_size(message: object, name: str, size: int, why: str) -> Flaw | None:
    """Return the flaw of a sequence that has another number of elements than other fields say."""
    count = len(getattr(message, name))
    return None if count == size else Flaw(name, _Count(count), f"{size} elements, {why}")


class _Count(int):
    """A number of elements."""

    def __repr__(self) -> str:
        return f"{int(self)} elements long"
