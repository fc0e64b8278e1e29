"""Describes the fields of a message type to the codec written in C, which reads them as a table."""

from __future__ import annotations

from typing import Any, NamedTuple

from robbie_mp.messages.codec.messages import codec_for
from robbie_mp.messages.field_types import (
    Field,
    FieldType,
    Items,
    MessageLayout,
    Nested,
    Numbers,
    Primitive,
    Several,
    Text,
    natural_default,
)

ANY = -1
"""For a length: any."""
KINDS: tuple[type[FieldType], ...] = (Primitive, Text, Nested, Numbers, Items)
"""The number of a kind of field is its place here."""


class FieldRow(NamedTuple):
    """A field, in the order and types that the C code reads.

    Attributes:
        name: its name in Python.
        default: its value if the constructor gets none.
        kind: its place in `KINDS`.
        code: of a number or of the elements of an array, as in the struct module; NUL: there is none.
        size: of the same, in bytes.
        length: the fixed number of elements.
        max_length: most elements, or bytes of a string.
        max_text: most bytes of each string in a list.
        smallest_item: bytes that an element of a list takes at least.
        dtype: of an array.
        empty: of an array, its natural default: no elements, or zeros.
        message: the class of a nested message, or of the elements of a list.
    """

    name: str
    default: Any
    kind: int
    code: str = "\0"
    size: int = 1
    length: int = ANY
    max_length: int = ANY
    max_text: int = ANY
    smallest_item: int = 1
    dtype: Any = None
    empty: Any = None
    message: type[Any] | None = None


def tabulate(layout: MessageLayout) -> tuple[FieldRow, ...]:
    """Return the table of a message type's fields."""
    return tuple(map(_row, layout.fields))


def _row(field: Field) -> FieldRow:
    kind = field.type
    row = FieldRow(field.name, field.default, KINDS.index(type(kind)))
    if isinstance(kind, Several):
        row = row._replace(length=_limit(kind.length), max_length=_limit(kind.max_length))
    match kind:
        case Primitive():
            return row._replace(code=kind.code, size=kind.size)
        case Text():
            return row._replace(max_length=_limit(kind.max_length))
        case Nested():
            return row._replace(message=kind.message)
        case Numbers(element=element):
            empty = natural_default(Numbers(element, kind.length))
            return row._replace(code=element.code, size=element.size, dtype=element.dtype, empty=empty)
        case Items(element=element):
            row = row._replace(smallest_item=codec_for(element).smallest)
            if isinstance(element, Text):
                return row._replace(max_text=_limit(element.max_length))
            return row._replace(message=element.message)


def _limit(length: int | None) -> int:
    return ANY if length is None else length
