"""Whether the values of a message make sense together: its types say so beside their fields.

A type with rules defines `flaw`; messages nested in it are checked as well. Rules look at single numbers,
sizes and small arrays, never at the contents of large ones.
"""

import math
import re
from typing import NamedTuple

import numpy as np

from robbie_mp.messages.errors import IllFormed
from robbie_mp.messages.message import Message

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


def find_flaw(message: Message) -> Flaw | None:
    """Return the first flaw of a message or of a message nested in it; None if it is well formed."""
    for name, is_list in message._ruled:
        value = getattr(message, name)
        if not is_list:
            if (flaw := find_flaw(value)) is not None:
                return flaw._replace(field=f"{name}.{flaw.field}")
            continue
        for index, one in enumerate(value):
            if (flaw := find_flaw(one)) is not None:
                return flaw._replace(field=f"{name}[{index}].{flaw.field}")
    return message.flaw()


def check_well_formed(message: Message) -> None:
    """Check a message and all messages nested in it.

    Raises:
        IllFormed: a rule of its type, or of one nested in it, does not hold.
    """
    if message.has_rules and (flaw := find_flaw(message)) is not None:
        raise ill_formed(message.type_name, flaw)


def ill_formed(type_name: str, flaw: Flaw) -> IllFormed:
    """Return the error for a flaw."""
    text = f"{type_name}.{flaw.field} is {flaw.value!r:.60}; expected {flaw.expected}"
    return IllFormed(text, type_name, re.sub(r"\[\d+\]", "[]", flaw.field))


# -- for the rules of types ----------------------------------------------------------------------------------


def beyond(message: Message, limit: float, *names: str) -> Flaw | None:
    """Return the first of some numbers that is not finite, or whose magnitude is greater than a limit."""
    for name in names:
        value = getattr(message, name)
        if not -limit <= value <= limit:
            return Flaw(name, value, f"a finite number of at most {limit:g} either way")
    return None


def outside(message: Message, low: float, high: float, *names: str, nan: bool = False) -> Flaw | None:
    """Return the first of some numbers that is not from `low` to `high`; NaN is allowed if `nan`."""
    for name in names:
        value = getattr(message, name)
        if not low <= value <= high and not (nan and math.isnan(value)):
            return Flaw(name, value, f"{low:g} to {high:g}{', or NaN if it is not known' if nan else ''}")
    return None


def nan_in(message: Message, *names: str) -> Flaw | None:
    """Return the first of some numbers that is NaN, where infinity has a meaning."""
    for name in names:
        if math.isnan(value := getattr(message, name)):
            return Flaw(name, value, "a number")
    return None


def elements_beyond(message: Message, limit: float, *names: str) -> Flaw | None:
    """Return the first element of some small arrays that is not finite, or beyond a limit."""
    for name in names:
        array = getattr(message, name)
        if len(array) and not (fits := np.abs(array) <= limit).all():
            index = int(np.argmin(fits))
            expected = f"a finite number of at most {limit:g} either way"
            return Flaw(f"{name}[{index}]", array[index].item(), expected)
    return None


def unlike_lengths(message: Message, of: str, *names: str, or_empty: bool = False) -> Flaw | None:
    """Return the first of some sequences that is not as long as another; `or_empty`: nor empty."""
    length = len(getattr(message, of))
    for name in names:
        count = len(getattr(message, name))
        if count != length and not (or_empty and not count):
            none = ", or none" if or_empty else ""
            return Flaw(name, _Count(count), f"{length} elements, as in {of}{none}")
    return None


def wrong_size(message: Message, name: str, size: int, why: str) -> Flaw | None:
    """Return the flaw of a sequence that has another number of elements than other fields say."""
    count = len(getattr(message, name))
    return None if count == size else Flaw(name, _Count(count), f"{size} elements, {why}")


class _Count(int):
    """A number of elements."""

    def __repr__(self) -> str:
        return f"{int(self)} elements long"
