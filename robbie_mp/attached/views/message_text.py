"""Messages as text: YAML to read, JSON and CSV for programs, as a whole or one field."""

import csv
import io
import json
import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.visible_text import one_line, visible_json
from robbie_mp.base.yaml_reader import read_text
from robbie_mp.messages import FieldTypeError, Message, PlaybackState, as_dict, from_dict
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers
from robbie_mp.messages.message import fields_of, nested
from robbie_mp.run.profile.show import inline

SHOWN = 8
"""Number of array elements shown to people unless they ask for all."""
STEP = re.compile(r"(\w+)((?:\[\d+\])*)")
PLAIN_NUMBER = re.compile(r"-?\d+(\.\d+)?")
INDEX = re.compile(r"\[(\d+)\]")


class NoSuchField(RobbieError, LookupError):
    """A path does not name a field of the message type."""


class FieldPath:
    """A field of a message, a nested field, or an array element: `pose.position.x`, `ranges[3]`.

    Args:
        message_type: the type that has the field.
        path: the field; '' for the whole message.

    Raises:
        NoSuchField: the type has no such field.
    """

    def __init__(self, message_type: type[Message], path: str):
        self._steps: list[str | int] = []
        kind: FieldType = nested(message_type)
        for part in path.split(".") if path else ():
            found = STEP.fullmatch(part)
            if found is None:
                raise NoSuchField(
                    f"{part!r} in {path!r} is no field; write it as pose.position.x or ranges[3]"
                )
            kind = self._field(kind, found[1], path)
            for index in INDEX.findall(found[2]):
                if not isinstance(kind, Numbers | Items):
                    raise NoSuchField(f"{path}: {found[1]} is a {kind}, no array")
                self._steps.append(int(index))
                kind = kind.element
        self.kind = kind

    def _field(self, kind: FieldType, name: str, path: str) -> FieldType:
        if not isinstance(kind, Nested):
            raise NoSuchField(f"{path}: a {kind} has no field {name!r}")
        kinds = {field.name: field.type for field in fields_of(kind.message)}
        if name not in kinds:
            near = did_you_mean(name, kinds) or f"; it has {', '.join(kinds)}"
            raise NoSuchField(f"{kind.message.type_name} has no field {name!r}{near}")
        self._steps.append(name)
        return kinds[name]

    def value(self, message: Message, *, full: bool = True) -> Any:
        """Return the field's value as plain data; None for an element beyond the end of an array.

        Args:
            message: the message.
            full: return arrays unchanged; if false, return long ones as `Abbreviated`.
        """
        value: Any = message
        for step in self._steps:
            if isinstance(step, int):
                if step >= len(value):
                    return None
                value = value[step]
            else:
                value = getattr(value, step)
        return _plain(value, full)


class Abbreviated(list[Any]):
    """The first elements of a long array, and its last one.

    Args:
        elements: those elements.
        missing: number of elements left out before the last one.
    """

    def __init__(self, elements: list[Any], missing: int):
        super().__init__(elements)
        self.missing = missing


def _plain(value: Any, full: bool) -> Any:
    """Convert to types that JSON has; arrays become lists."""
    if isinstance(value, Message):
        return {name: _plain(inner, full) for name, inner in as_dict(value).items()}
    if isinstance(value, dict):
        return {name: _plain(inner, full) for name, inner in value.items()}
    if isinstance(value, list | np.ndarray) and len(value) > SHOWN and not full:
        return Abbreviated(
            [_plain(item, full) for item in (*value[: SHOWN - 1], value[-1])], len(value) - SHOWN
        )
    if isinstance(value, list):
        return [_plain(item, full) for item in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def message_of_yaml(message_type: type[Message], text: str) -> Message:
    """Return the message with the fields that a YAML text gives.

    Raises:
        ProfileError: the text is not YAML.
        FieldError: a field does not exist or does not fit; the text names it with its path.
    """
    plain = read_text(text, message_type.type_name).plain()
    if not isinstance(plain, dict):
        raise FieldTypeError(
            f"{message_type.type_name}: expected a map of its fields, as in '{{field: 1}}', got {plain!r:.60}"
        )
    return from_dict(message_type, plain)


def to_yaml(value: Any) -> str:
    """Return plain data as YAML, each list on one line."""
    return "\n".join(_yaml_lines(value, ""))


def _yaml_lines(value: Any, indent: str) -> Iterator[str]:
    if not isinstance(value, dict):
        yield indent + _yaml_inline(value)
        return
    for name, inner in value.items():
        if isinstance(inner, dict) and inner:
            yield f"{indent}{name}:"
            yield from _yaml_lines(inner, indent + "  ")
        else:
            yield f"{indent}{name}: {_yaml_inline(inner)}"


def _yaml_inline(value: Any) -> str:
    if PLAIN_NUMBER.fullmatch(number := repr(value)):
        return number  # a YAML library takes a hundred times as long for numbers
    if not isinstance(value, Abbreviated):
        return inline(value)
    first = inline(list(value[:-1])).removesuffix("]")
    return f"{first}, … {value.missing} more …, {inline(value[-1])}]"


def to_json(value: Any) -> str:
    """Return plain data as JSON on one line; infinity and not-a-number become null, as JSON lacks them."""
    return visible_json(json.dumps(_without_infinity(value), ensure_ascii=False, allow_nan=False))


def _without_infinity(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_infinity(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_without_infinity(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def to_csv(cells: list[Any]) -> str:
    """Return a row of CSV (RFC 4180) on one line; control characters and line ends are made visible."""
    row = io.StringIO()
    shown = [one_line(cell) if isinstance(cell, str) else cell for cell in cells]
    csv.writer(row, lineterminator="").writerow(shown)
    return row.getvalue()


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield columns and cells of plain data: nested messages by dotted names, lists as JSON in one cell."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from flat(inner, f"{name}.{key}" if name else key)
    else:
        yield name, to_json(value) if isinstance(value, list) else value


def describe_playback(state: PlaybackState) -> str:
    """Describe the state of a playback in one line."""
    at_s, end_s = ((time.nanoseconds - state.begin.nanoseconds) / 1e9 for time in (state.position, state.end))
    pace = "as fast as possible" if math.isinf(state.rate) else f"rate {state.rate:g}"
    doing = "ended" if state.ended else "paused" if state.paused else "plays"
    return f"{doing} at {at_s:.3f} of {end_s:.3f} s, {state.messages} messages, {pace}"
