"""By how much the numbers of two messages differ, field by field."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from robbie_mp.messages import Header, Message
from robbie_mp.messages.message import fields_of

MOST_FIELDS = 1000
"""Of one channel; the differences of further ones are not kept."""


@dataclass
class Amount:
    """How much one field has differed so far."""

    messages: int = 0
    """In how many messages it differed."""
    total: float = 0.0
    """The sum, over these, of the largest difference in each."""
    largest: float = 0.0

    def add(self, difference: float) -> None:
        """Add the largest difference in a message."""
        self.messages += 1
        self.total += difference
        self.largest = max(self.largest, difference)

    @property
    def mean(self) -> float:
        """The mean of the largest difference in each message that differs."""
        return self.total / self.messages


def amounts(a: Message, b: Message, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield each field whose numbers differ, with the largest difference; times of headers are left out."""
    names = [field.name for field in fields_of(type(a))]
    if names != [field.name for field in fields_of(type(b))]:
        return
    for name in names:
        if not (name == "stamp" and type(a).type_name == Header.type_name):
            inner = f"{path}.{name}" if path else name
            yield from _of_values(getattr(a, name), getattr(b, name), inner)


def _of_values(a: Any, b: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(a, Message) and isinstance(b, Message):
        yield from amounts(a, b, path)
    elif isinstance(a, list) and isinstance(b, list):
        largest: dict[str, float] = {}
        for one, other in zip(a, b, strict=False):
            for inner, difference in _of_values(one, other, f"{path}[]"):
                largest[inner] = max(largest.get(inner, 0.0), difference)
        yield from largest.items()
    elif (difference := _largest(a, b)) > 0:
        yield path, difference


def _largest(a: Any, b: Any) -> float:
    """Return the largest difference of two numbers, or of two arrays of the same shape; 0 for all else."""
    try:
        first, second = np.asarray(a, np.float64), np.asarray(b, np.float64)
    except (TypeError, ValueError):
        return 0.0
    if first.shape != second.shape or not first.size:
        return 0.0
    same = (first == second) | (np.isnan(first) & np.isnan(second))
    with np.errstate(invalid="ignore"):
        apart = np.where(same, 0.0, np.abs(first - second))
    return float(np.nan_to_num(apart, nan=np.inf).max())
