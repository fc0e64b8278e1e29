"""The types of message fields: the five kinds that CDR and ros2msg share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robbie_mp.messages.errors import DeclarationError


@dataclass(frozen=True, slots=True)
class Primitive:
    """A number or bool of fixed size.

    Attributes:
        name: its name in ros2msg, such as `float32`.
        code: its letter in the struct module.
        size: its size and alignment in bytes.
        zero: its default.
    """

    name: str
    code: str
    size: int
    zero: bool | int | float

    @property
    def dtype(self) -> np.dtype[Any]:
        """The numpy type of its arrays: little endian, as in the encoding."""
        return np.dtype("<" + self.code)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Text:
    """A UTF-8 string of at most `max_length` bytes (None: any)."""

    max_length: int | None = None

    def __str__(self) -> str:
        return "string" if self.max_length is None else f"string<={self.max_length}"


@dataclass(frozen=True, slots=True)
class Nested:
    """A message inside another message."""

    layout: MessageLayout

    @property
    def message(self) -> type[Any]:
        """The class of the inner message."""
        return self.layout.final

    def __str__(self) -> str:
        return short_name(self.layout.type_name)


@dataclass(frozen=True, slots=True)
class Several:
    """Elements of one type: exactly `length` of them, or a sequence of at most `max_length` (None: any)."""

    element: Primitive | Text | Nested
    length: int | None = None
    max_length: int | None = None

    def __post_init__(self) -> None:
        for length in (self.length, self.max_length):
            if length is not None and not (isinstance(length, int) and length >= 1):
                raise DeclarationError(f"{self}: the length of an array is an int >= 1")

    def __str__(self) -> str:
        if self.length is not None:
            return f"{self.element}[{self.length}]"
        return f"{self.element}[]" if self.max_length is None else f"{self.element}[<={self.max_length}]"


@dataclass(frozen=True, slots=True)
class Numbers(Several):
    """Primitives, held as a numpy array."""

    element: Primitive


@dataclass(frozen=True, slots=True)
class Items(Several):
    """Strings or nested messages, held as a list."""

    element: Text | Nested


FieldType = Primitive | Text | Nested | Numbers | Items


class _Default:
    def __repr__(self) -> str:
        return "DEFAULT"


DEFAULT: Any = _Default()
"""Assign it to a field so that type checkers accept a constructor call without the field.

The value is 0, False, "", empty, or the nested type's default, as for any field left out at run time.
"""


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message.

    Attributes:
        name: its name in Python.
        type: what it holds.
        declared_default: the default in the declaration.
    """

    name: str
    type: FieldType
    declared_default: Any = DEFAULT

    @property
    def schema_name(self) -> str:
        """Its name in ros2msg, without the underscore that follows reserved names in Python."""
        return self.name.removesuffix("_")

    @property
    def default(self) -> Any:
        """The value of the field if the constructor gets none."""
        return natural_default(self.type) if self.declared_default is DEFAULT else self.declared_default


@dataclass(frozen=True, slots=True, eq=False)
class MessageLayout:
    """A message type as the codec sees it.

    Attributes:
        type_name: its ROS name, such as `sensor_msgs/msg/LaserScan`.
        version: version number from 1; it grows whenever the fields change.
        fields: the fields, in the order of the encoding.
        blank: the class of a message while its fields are set: it has the slots and is mutable.
        final: the immutable class of a complete message: the message class itself.
    """

    type_name: str
    version: int
    fields: tuple[Field, ...]
    blank: type[Any]
    final: type[Any]

    @property
    def has_views(self) -> bool:
        """Whether a decoded message may hold arrays that are views of the buffer it was decoded from."""
        return any(map(_has_arrays, self.fields))


def _has_arrays(field: Field) -> bool:
    kind = field.type.element if isinstance(field.type, Items) else field.type
    return isinstance(kind, Numbers) or (isinstance(kind, Nested) and kind.layout.has_views)


@dataclass(frozen=True, slots=True)
class FixedLength:
    """Annotation for exactly `length` elements: `Annotated[list[Point], FixedLength(4)]`."""

    length: int


@dataclass(frozen=True, slots=True)
class MaxLength:
    """Annotation for at most `length` elements, or bytes of a string: `Annotated[str, MaxLength(20)]`."""

    length: int


def short_name(type_name: str) -> str:
    """Return a type name as written in ros2msg texts: `std_msgs/Header` for `std_msgs/msg/Header`."""
    package, _, name = type_name.split("/")
    return f"{package}/{name}"


def natural_default(kind: FieldType) -> Any:
    """Return the default of a field that declares none: 0, False, "", empty, or the nested type's default."""
    match kind:
        case Primitive():
            return kind.zero
        case Text():
            return ""
        case Nested():
            return kind.message()
        case Numbers():
            return constant_array(np.zeros(kind.length or 0, kind.element.dtype))
        case Items():
            return [natural_default(kind.element) for _ in range(kind.length or 0)]


def constant_array(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Make the array read-only, so that many messages can share it, and return it."""
    array.flags.writeable = False
    return array
