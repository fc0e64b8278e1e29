"""Locates the error in bytes that do not encode a message type.

The generated decoders only detect that something is wrong. This reader goes through the bytes again, slowly,
field by field, and reports the field, the byte and the reason.
"""

from __future__ import annotations

from collections.abc import Sequence

from robbie_mp.messages.codec.decoder import MAX_TRAILING_BYTES, smallest_size
from robbie_mp.messages.codec.placement import ENCAPSULATION_SIZE, padding
from robbie_mp.messages.codec.plan import ROOT, Plan
from robbie_mp.messages.errors import DecodeError
from robbie_mp.messages.field_types import (
    Field,
    FieldType,
    Items,
    Nested,
    Numbers,
    Primitive,
    Text,
)


def find_failure(type_name: str, fields: Sequence[Field], data: memoryview) -> DecodeError | None:
    """Return the error in `data` as an encoding of the message type; None if there is none."""
    try:
        _Walk(type_name, data).whole_message(fields)
    except DecodeError as found:
        return found.with_traceback(None)  # its frames would keep each other, and the buffer, alive
    return None


class _Walk:
    def __init__(self, type_name: str, data: memoryview):
        self._type_name = type_name
        self._data = data
        self._position = 0

    def whole_message(self, fields: Sequence[Field]) -> None:
        encapsulation = self._take("encapsulation", ENCAPSULATION_SIZE).tobytes()
        if encapsulation[:2] != b"\x00\x01":
            raise self._failure(
                "encapsulation", f"it is {encapsulation.hex(' ')}, XCDR1 little endian is 00 01 00 00", 4
            )
        self._fields("", fields)
        left = len(self._data) - self._position
        if left > MAX_TRAILING_BYTES:
            raise self._failure(
                "", f"{left} bytes are left behind the last field; is it another version of the type?"
            )

    def _fields(self, path: str, fields: Sequence[Field]) -> None:
        if not fields:
            self._take(path, 1)
        for field in fields:
            self._field(f"{path}.{field.schema_name}", field.type)

    def _field(self, path: str, kind: FieldType) -> None:
        match kind:
            case Primitive():
                self._numbers(path, kind, 1)
            case Text():
                self._text(path, kind)
            case Nested():
                self._fields(path, kind.layout.fields)
            case Numbers():
                self._numbers(path, kind.element, self._count(path, kind, kind.element.size))
            case Items():
                plan = Plan()
                plan.add(ROOT, kind.element)
                for index in range(self._count(path, kind, smallest_size(plan))):
                    self._field(f"{path}[{index}]", kind.element)

    def _count(self, path: str, kind: Numbers | Items, least_size: int) -> int:
        """Read the length word of a sequence, or return the length of a fixed array."""
        if kind.length is not None:
            return kind.length
        count, left = self._word(path), len(self._data) - self._position
        if kind.max_length is not None and count > kind.max_length:
            raise self._failure(path, f"{count} elements are more than {kind.max_length}", 4)
        if count * least_size > left:
            raise self._failure(
                path, f"{count} elements of at least {least_size} bytes, but {left} bytes are left", 4
            )
        return count

    def _numbers(self, path: str, element: Primitive, count: int) -> None:
        if count:
            self._position += padding(self._position, element.size)
            self._take(path, count * element.size)

    def _text(self, path: str, kind: Text) -> None:
        length = self._word(path)
        octets = self._take(path, length).tobytes()
        if octets and octets[-1]:
            raise self._failure(path, "a string ends with a NUL, this one does not", 1)
        if kind.max_length is not None and length - 1 > kind.max_length:
            raise self._failure(path, f"{length - 1} bytes of text are more than {kind.max_length}", length)
        try:
            octets[:-1].decode()
        except UnicodeDecodeError as error:
            raise self._failure(path, f"not UTF-8: {error.reason}", length - error.start) from None

    def _word(self, path: str) -> int:
        self._position += padding(self._position, 4)
        return int.from_bytes(self._take(path, 4), "little")

    def _take(self, path: str, size: int) -> memoryview:
        left = max(len(self._data) - self._position, 0)
        if size > left:
            raise self._failure(path, f"needs {size} bytes, {left} are left")
        self._position += size
        return self._data[self._position - size : self._position]

    def _failure(self, path: str, what: str, back: int = 0) -> DecodeError:
        """Return the error for what was found `back` bytes before the current position."""
        dot = "" if not path or path.startswith(".") else " "
        return DecodeError(f"{self._type_name}{dot}{path} at byte {self._position - back}: {what}")
