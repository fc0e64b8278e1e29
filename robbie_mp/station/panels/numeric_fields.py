"""Numbers in messages, named by paths such as `pose.pose.position.x` or `ranges[90]`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Primitive
from robbie_mp.messages.message import fields_of, nested

Step = str | int
"""A field's name, or an element's number."""
STEP = re.compile(r"\.?([A-Za-z_]\w*)|\[(\d{1,9})\]")
MAX_OFFERED_ELEMENTS = 9
"""Maximum number of elements offered for an array of fixed length. Of other arrays, the first is offered."""
MAX_DEPTH = 8


class NoSuchNumber(RobbieError, LookupError):
    """A path does not lead to a number in messages of a type.

    Example scenarios:
      - a field is misspelt
      - it leads to a text, or to an array as a whole
    """


def numeric_paths(message_type: type[Message]) -> list[str]:
    """Return the paths of all numbers in a type, with the first element of arrays of variable length."""
    return [path for field in fields_of(message_type) for path in _paths(field.name, field.type, 1)]


def _paths(path: str, kind: FieldType, depth: int) -> Iterator[str]:
    if isinstance(kind, Primitive):
        yield path
    elif isinstance(kind, Nested) and depth < MAX_DEPTH:
        for field in fields_of(kind.message):
            yield from _paths(f"{path}.{field.name}", field.type, depth + 1)
    elif isinstance(kind, Numbers | Items):
        for index in range(min(kind.length or 1, MAX_OFFERED_ELEMENTS)):
            yield from _paths(f"{path}[{index}]", kind.element, depth)


def number_reader(message_type: type[Message], path: str) -> Callable[[Message], float | None]:
    """Return a function that reads the number at a path. It returns None for a missing element.

    Raises:
        NoSuchNumber: the path leads to no number.
    """
    steps = _steps(path)
    kind: FieldType = nested(message_type)
    for step in steps:
        kind = _after(kind, step, path)
    if not isinstance(kind, Primitive):
        raise NoSuchNumber(f"{path!r} is no number, but {kind}")

    def read(message: Message) -> float | None:
        found: Any = message
        try:
            for step in steps:
                found = getattr(found, step) if isinstance(step, str) else found[step]
        except IndexError:
            return None
        return float(found)

    return read


def _steps(path: str) -> list[Step]:
    steps: list[Step] = []
    at = 0
    while at < len(path):
        match = STEP.match(path, at)
        if match is None:
            raise NoSuchNumber(f"expected a path such as pose.position.x or ranges[90]; got {path!r}")
        steps.append(match[1] or int(match[2]))
        at = match.end()
    return steps


def _after(kind: FieldType, step: Step, path: str) -> FieldType:
    if isinstance(kind, Nested) and isinstance(step, str):
        kinds = {field.name: field.type for field in fields_of(kind.message)}
        if step in kinds:
            return kinds[step]
        near = did_you_mean(step, kinds) or f"; it has {', '.join(kinds)}"
        raise NoSuchNumber(f"{path!r}: {kind} has no field {step!r}{near}")
    if isinstance(kind, Numbers | Items) and isinstance(step, int):
        if kind.length is not None and step >= kind.length:
            raise NoSuchNumber(f"{path!r}: there are only {kind.length} elements")
        return kind.element
    raise NoSuchNumber(f"{path!r}: there is nothing like {step!r} in {kind}")
