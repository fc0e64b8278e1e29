"""Messages written in place: you fill large arrays in the memory that subscribers read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from robbie_mp.messages.codec.fields import Lent
from robbie_mp.messages.errors import FieldTypeError, FieldValueError
from robbie_mp.messages.field_types import Numbers
from robbie_mp.messages.message import Message, fields_of, replace

_Message = TypeVar("_Message", bound=Message)
_Message_co = TypeVar("_Message_co", bound=Message, covariant=True)


class Layout(Protocol[_Message_co]):
    """The layout of a message before some of its arrays have contents."""

    @property
    def size(self) -> int:
        """Size of the encoding in bytes."""

    @property
    def loaned(self) -> frozenset[str]:
        """The fields whose elements are filled later."""

    def write(self, buffer: memoryview, offset: int = 0) -> _Message_co:
        """Write everything except the elements of the loaned arrays.

        Args:
            buffer: writable bytes.
            offset: where in the buffer the encoding begins.

        Returns:
            The message; its loaned arrays are writable views of the buffer and are not initialized.

        Raises:
            BufferTooSmall: the message does not fit.
        """


def lay_out(message_type: type[_Message], fields: Mapping[str, object]) -> Layout[_Message]:
    """Lay out a message of which some arrays will be filled in place.

    Args:
        message_type: its class.
        fields: as for its constructor; but an int for a sequence of numbers (an `Array[…]` of the message
            itself, not of a nested one) lends this number of elements, which are not initialized.

    Raises:
        FieldError: a value does not fit its field.
    """
    codec = message_type._codec
    layout = None if codec is None else codec.lay_out(dict(fields), lay_out_in_python)
    return lay_out_in_python(message_type, fields) if layout is None else layout


@dataclass(frozen=True, slots=True)
class PythonLayout(Generic[_Message]):
    """A `Layout` written by the codec in Python."""

    size: int
    loaned: frozenset[str]
    _outline: _Message

    def write(self, buffer: memoryview, offset: int = 0) -> _Message:
        """Write everything except the elements of the loaned arrays, see `Layout`."""
        self._outline.encode_into(buffer, offset)
        if not self.loaned:
            return self._outline
        lent = {name: getattr(self._outline, name) for name in self.loaned}
        message = replace(self._outline, **{name: one.array for name, one in lent.items()})
        for one in lent.values():
            one.array = None  # the layout keeps no array, so that the arrays go when their user lets them go
        return message


def lay_out_in_python(message_type: type[_Message], fields: Mapping[str, object]) -> PythonLayout[_Message]:
    """Lay out a message as `lay_out`, which calls this for what C does not do."""
    lent = {
        field.name: Lent(_checked(f"{message_type.type_name}.{field.schema_name}", field.type, count))
        for field in fields_of(message_type)
        if isinstance(field.type, Numbers) and isinstance(count := fields.get(field.name), int)
    }
    outline = message_type(**{name: value for name, value in fields.items() if name not in lent})
    for name, elements in lent.items():
        object.__setattr__(outline, name, elements)
    return PythonLayout(outline.encoded_size(), frozenset(lent), outline)


def _checked(path: str, kind: Numbers, count: int) -> int:
    if kind.length is not None or isinstance(count, bool):
        raise FieldTypeError(f"{path}: expected an array for {kind}, got {count!r}; only sequences are lent")
    if count < 0 or (kind.max_length is not None and count > kind.max_length):
        raise FieldValueError(f"{path}: cannot lend {count} elements of {kind}")
    return count
