"""Numbers over time: fields of messages by name, as `robbie plot` draws them."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import accumulate
from typing import NamedTuple

from robbie_mp.attached.views.message_text import FieldPath
from robbie_mp.base.errors import RobbieError
from robbie_mp.messages import Message
from robbie_mp.messages.field_types import Nested, Primitive, Several
from robbie_mp.messages.message import fields_of

MOST_POINTS = 10_000
"""Points that a series keeps; more than a screen or a picture can show."""


class NotANumber(RobbieError, TypeError):
    """A field cannot be drawn.

    Example scenarios:
      - it is a whole message: the text names its fields
      - it is an array, of which one element must be named
    """


class PlottedField(NamedTuple):
    """A field of messages, as it was named.

    Attributes:
        messages: name of a topic or type.
        path: the field.
    """

    messages: str
    path: str


def splits(name: str) -> Iterator[PlottedField]:
    """Yield the ways in which a name such as `odom.pose.x` is a topic or type, and a field."""
    parts = name.split(".")
    heads = list(accumulate(parts, lambda head, part: f"{head}.{part}"))
    for number, head in enumerate(heads[:-1], start=1):
        yield PlottedField(head, ".".join(parts[number:]))


def number_field(message_type: type[Message], path: str) -> Callable[[Message], float | None]:
    """Return the function that gets a number from a message; None for an element that is not there.

    Raises:
        NoSuchField: the type has no such field.
        NotANumber: the field is no number.
    """
    found = FieldPath(message_type, path)
    if isinstance(found.kind, Primitive):
        return found.value
    if isinstance(found.kind, Nested):
        names = ", ".join(one.name for one in fields_of(found.kind.message))
        raise NotANumber(f"{path} is a {found.kind}; name one of its fields: {names}")
    hint = (
        f"; name one of its elements, such as {path}[0]" if isinstance(found.kind, Several) else ", no number"
    )
    raise NotANumber(f"{path} is a {found.kind}{hint}")


@dataclass
class PlotSeries:
    """The newest values of a field, or, of a recording, all of them, thinned out evenly.

    Attributes:
        name: the label.
        times_s, values: the points.
        passed: values that were added so far.
    """

    name: str
    times_s: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    passed: int = 0
    _stride: int = 1

    def add(self, time_s: float, value: float) -> None:
        """Add a point; if there are too many, every second one is dropped. Infinity cannot be drawn."""
        if not math.isfinite(value):
            return
        if self.passed % self._stride == 0:
            self.times_s.append(time_s)
            self.values.append(value)
        self.passed += 1
        if len(self.values) > MOST_POINTS:
            del self.times_s[1::2], self.values[1::2]
            self._stride *= 2

    def forget_before(self, time_s: float) -> None:
        """Drop points that are older."""
        old = next((at for at, time in enumerate(self.times_s) if time >= time_s), len(self.times_s))
        del self.times_s[:old], self.values[:old]
