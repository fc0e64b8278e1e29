"""Encodes and decodes messages: small objects, one for each field, that call one another.

The C code does the same from the same descriptions; this is its specification.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from operator import attrgetter
from typing import Any, NamedTuple

from robbie_mp.messages.codec.cdr import LARGEST_ALIGNMENT
from robbie_mp.messages.codec.fields import (
    Codec,
    DamageError,
    ItemsCodec,
    Leaf,
    NumbersCodec,
    ScalarsCodec,
    TextCodec,
)
from robbie_mp.messages.field_types import Items, MessageLayout, Nested, Numbers, Primitive, Text

FILLER = Primitive("filler", "x", 1, 0)
"""The byte of a message without fields (IDL forbids empty structures; ROS 2 inserts one byte)."""


def codec_for(kind: Text | Nested | Numbers | Items) -> Codec:
    """Return the codec of a type of fields; primitives get one for each run, see `ScalarsCodec`."""
    match kind:
        case Text():
            return TextCodec(kind)
        case Nested():
            return MessageCodec(kind.layout)
        case Numbers():
            return NumbersCodec(kind)
        case Items():
            return ItemsCodec(kind, codec_for(kind.element))


class FieldStep(NamedTuple):
    """A codec of a message, with what gets its value from the message, and the path of its field."""

    values: Callable[[Any], Any]
    codec: Codec
    path: str


class MessageCodec(Codec):
    """A message. CDR does not mark those nested in it, so all their fields are steps of this one."""

    def __init__(self, layout: MessageLayout):
        self._steps = list(_steps(_leaves(layout)))
        self._build = _builder(layout)
        self.smallest = sum(step.codec.smallest for step in self._steps)
        self.sizes = _sizes([step.codec for step in self._steps])

    def end(self, at: int, value: Any) -> int:
        """Return where its last field ends."""
        for values, codec, _ in self._steps:
            if codec.sizes:
                at += codec.sizes[at % LARGEST_ALIGNMENT]
            else:
                at = codec.end(at, values(value))
        return at

    def write(self, buffer: memoryview, at: int, value: Any) -> int:
        """Encode its fields."""
        for values, codec, _ in self._steps:
            at = codec.write(buffer, at, values(value))
        return at

    def read(self, data: memoryview, at: int, into: list[Any]) -> int:
        """Append it."""
        values: list[Any] = []
        path = ""
        try:
            for _, codec, path in self._steps:  # noqa: B007 (used if there is damage)
                at = codec.read(data, at, values)
        except DamageError as error:
            error.path = path + error.path
            raise
        into.append(self._build(iter(values)))
        return at


def _leaves(layout: MessageLayout, name: str = "", path: str = "") -> Iterator[Leaf]:
    if not layout.fields:
        yield Leaf(name, path, FILLER)
    for field in layout.fields:
        its_name, its_path = name + field.name, f"{path}.{field.schema_name}"
        if isinstance(field.type, Nested):
            yield from _leaves(field.type.layout, its_name + ".", its_path)
        else:
            yield Leaf(its_name, its_path, field.type)


def _steps(leaves: Iterable[Leaf]) -> Iterator[FieldStep]:
    for is_scalar, group in groupby(leaves, lambda leaf: isinstance(leaf.type, Primitive)):
        if is_scalar:
            run = list(group)
            names = [leaf.name for leaf in run if leaf.type is not FILLER]
            yield FieldStep(_tuple_getter(names), ScalarsCodec(run), "")
        else:
            for leaf in group:
                if not isinstance(leaf.type, Primitive):
                    yield FieldStep(attrgetter(leaf.name), codec_for(leaf.type), leaf.path)


def _builder(layout: MessageLayout) -> Callable[[Iterator[Any]], Any]:
    """Return what makes a message of the values of its leaves.

    The message is filled while it has a mutable class, then gets its final, immutable class.
    """
    blank, final = layout.blank, layout.final
    members = [
        (field.name, _builder(field.type.layout) if isinstance(field.type, Nested) else next)
        for field in layout.fields
    ]

    def build(values: Iterator[Any]) -> Any:
        message = blank()
        for name, take in members:
            setattr(message, name, take(values))
        message.__class__ = final
        return message

    return build


def _tuple_getter(names: Sequence[str]) -> Callable[[Any], Any]:
    """Return what gets a tuple of attributes, also of one or none."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda message: tuple(attrgetter(name)(message) for name in names)


def _sizes(codecs: Sequence[Codec]) -> tuple[int, ...]:
    """Return the size of values that follow one another, as `Codec.sizes`."""
    if not all(codec.sizes for codec in codecs):
        return ()
    ends = list(range(LARGEST_ALIGNMENT))
    for codec in codecs:
        ends = [at + codec.sizes[at % LARGEST_ALIGNMENT] for at in ends]
    return tuple(end - start for start, end in enumerate(ends))
