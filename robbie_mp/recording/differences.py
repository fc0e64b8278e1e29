"""Finds where two logged messages differ, and hides what should not be compared."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from robbie_mp.messages import Header, Message
from robbie_mp.messages.errors import MessageError
from robbie_mp.messages.field_types import FieldType, Items, Nested
from robbie_mp.messages.message import fields_of, nested
from robbie_mp.recording.decoding import logged_type
from robbie_mp.recording.errors import NotDecodable
from robbie_mp.recording.reader import LogChannel, LoggedMessage


@dataclass(frozen=True)
class Difference:
    """The first difference between two messages.

    Attributes:
        index: index of the message in its channel of log A, from 0.
        time_ns: when it was published in log A.
        field: its path, such as `pose.position.x` or `ranges[3]`; "" if no field differs.
        a: the value in A; without a field, where the bytes differ.
        b: the value in B.
    """

    index: int
    time_ns: int
    field: str
    a: str
    b: str


def first_difference(a: LoggedMessage, b: LoggedMessage, index: int, *, ignore_stamps: bool) -> Difference:
    """Return where two messages differ; they must not be equal."""
    found = next(_differing_fields(a, b, ignore_stamps), None)
    if found is None:
        place = next(
            (at for at, pair in enumerate(zip(a.data, b.data, strict=False)) if pair[0] != pair[1]), None
        )
        place = min(len(a.data), len(b.data)) if place is None else place
        found = ("", f"byte {place} of {len(a.data)}", f"byte {place} of {len(b.data)}")
    return Difference(index, a.time_ns, *found)


def _differing_fields(
    a: LoggedMessage, b: LoggedMessage, ignore_stamps: bool
) -> Iterator[tuple[str, str, str]]:
    try:
        decoded_a, decoded_b = (logged_type(one.channel).decode(one.data) for one in (a, b))
    except (MessageError, NotDecodable):
        return
    yield from _of_messages(decoded_a, decoded_b, "", ignore_stamps)


def _of_messages(a: Message, b: Message, path: str, ignore_stamps: bool) -> Iterator[tuple[str, str, str]]:
    names = [field.name for field in fields_of(type(a))]
    others = [field.name for field in fields_of(type(b))]
    if names != others:
        yield path, f"fields {', '.join(names)}", f"fields {', '.join(others)}"
        return
    for name in names:
        if ignore_stamps and name == "stamp" and type(a).type_name == Header.type_name:
            continue
        inner = f"{path}.{name}" if path else name
        yield from _of_values(getattr(a, name), getattr(b, name), inner, ignore_stamps)


def _of_values(a: Any, b: Any, path: str, ignore_stamps: bool) -> Iterator[tuple[str, str, str]]:
    if isinstance(a, Message) and isinstance(b, Message):
        yield from _of_messages(a, b, path, ignore_stamps)
    elif isinstance(a, list | np.ndarray) and isinstance(b, list | np.ndarray):
        if len(a) != len(b):
            yield path, f"{len(a)} elements", f"{len(b)} elements"
            return
        is_numeric = isinstance(a, np.ndarray) and isinstance(b, np.ndarray)
        for place in np.flatnonzero(a != b).tolist() if is_numeric else range(len(a)):
            yield from _of_values(a[place], b[place], f"{path}[{place}]", ignore_stamps)
    elif (text := _text(a)) != _text(b):  # as text, because not-a-number equals itself there
        yield path, text, _text(b)


def _text(value: Any) -> str:
    return repr(value.item() if isinstance(value, np.generic) else value)


def without_stamps(channel: LogChannel) -> Callable[[bytes], bytes]:
    """Return a function that makes messages equal if they differ only in the stamps of their headers."""
    try:
        written = logged_type(channel)
    except (MessageError, NotDecodable):
        return bytes
    if not _has_header(nested(written)):
        return bytes

    def plain(data: bytes) -> bytes:
        try:
            return _unstamped(written.decode(data)).encode()
        except MessageError:
            return data

    return plain


def _has_header(kind: FieldType) -> bool:
    kind = kind.element if isinstance(kind, Items) else kind
    return isinstance(kind, Nested) and (
        kind.message.type_name == Header.type_name
        or any(_has_header(field.type) for field in fields_of(kind.message))
    )


def _unstamped(message: Message) -> Message:
    kind = type(message)
    values = {field.name: getattr(message, field.name) for field in fields_of(kind)}
    if kind.type_name == Header.type_name and "stamp" in values:
        values["stamp"] = type(values["stamp"])()
    for field in fields_of(kind):
        if _has_header(field.type):
            value = values[field.name]
            values[field.name] = [*map(_unstamped, value)] if isinstance(value, list) else _unstamped(value)
    return kind(**values)
