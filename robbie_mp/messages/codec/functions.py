"""Makes the functions of a message type from its layout.

Nothing is installed here: `message.py` gives the functions to the class.
"""

from __future__ import annotations

from collections.abc import Callable
from pickle import PickleBuffer
from typing import Any

from robbie_mp.messages.codec.cdr import CDR_LITTLE_ENDIAN, ENCAPSULATION_SIZE, MAX_TRAILING_BYTES
from robbie_mp.messages.codec.constructor import constructor
from robbie_mp.messages.codec.fields import WORD, DamageError
from robbie_mp.messages.codec.messages import MessageCodec
from robbie_mp.messages.errors import BufferTooSmall, DecodeError, FieldError, MessageError
from robbie_mp.messages.field_types import Items, MessageLayout, Nested
from robbie_mp.messages.fitting import fit

_ENCAPSULATION = WORD.unpack(CDR_LITTLE_ENDIAN)[0]
ADVICE = "is it another version of the type?"


def sizer(layout: MessageLayout) -> Callable[..., int]:
    """Return the function `encoded_size(self)`."""
    codec = MessageCodec(layout)
    fixed = codec.sizes and ENCAPSULATION_SIZE + codec.sizes[ENCAPSULATION_SIZE]

    def encoded_size(self: Any) -> int:
        if fixed:
            return fixed
        try:
            return codec.end(ENCAPSULATION_SIZE, self)
        except Exception as error:
            raise _explain(layout, self, None, error) from error

    return encoded_size


def encoder(layout: MessageLayout) -> Callable[..., int]:
    """Return the function `encode_into(self, buffer, offset=0)`."""
    codec = MessageCodec(layout)

    def encode_into(self: Any, buffer: memoryview, offset: int = 0) -> int:
        if offset or type(buffer) is not memoryview:
            buffer = memoryview(buffer)[offset:]
        try:
            WORD.pack_into(buffer, 0, _ENCAPSULATION)
            return codec.write(buffer, ENCAPSULATION_SIZE, self)
        except Exception as error:
            raise _explain(layout, self, buffer, error) from error

    return encode_into


def decoder(layout: MessageLayout) -> Callable[[Any], Any]:
    """Return the function `decode(buffer)`."""
    codec = MessageCodec(layout)

    def decode(buffer: Any) -> Any:
        # A memoryview of a memoryview refers to the exporter at the end of the chain, not to the memoryview
        # in between, and numpy makes one for every array. A PickleBuffer between them keeps `buffer` alive.
        data = PickleBuffer(buffer).raw()
        decoded: list[Any] = []
        try:
            if len(data) < ENCAPSULATION_SIZE or data[:2] != CDR_LITTLE_ENDIAN[:2]:
                raise _wrong_encapsulation(data)
            end = codec.read(data, ENCAPSULATION_SIZE, decoded)
            if len(data) - end > MAX_TRAILING_BYTES:
                raise DamageError(f"{len(data) - end} bytes are left behind the last field; {ADVICE}", end)
        except DamageError as error:
            raise DecodeError(f"{layout.type_name}{error.path} at byte {error.at}: {error.what}") from None
        return decoded[0]

    return decode


FUNCTIONS: dict[str, Callable[[MessageLayout], Callable[..., Any]]] = {
    "__new__": constructor,
    "encoded_size": sizer,
    "encode_into": encoder,
    "decode": decoder,
}
"""What makes each function of a message class, by its name."""


def _wrong_encapsulation(data: memoryview) -> DamageError:
    begin = bytes(data[:ENCAPSULATION_SIZE])
    what = f"it is {begin.hex(' ')}, XCDR1 little endian is {CDR_LITTLE_ENDIAN.hex(' ')}"
    if len(begin) < ENCAPSULATION_SIZE:
        what = f"needs {ENCAPSULATION_SIZE} bytes, {len(begin)} are left"
    return DamageError(what, 0, " encapsulation")


def _explain(layout: MessageLayout, message: Any, buffer: memoryview | None, error: Exception) -> Exception:
    """Return the error that says why a message could not be encoded."""
    try:
        if buffer is not None and len(buffer) < (size := message.encoded_size()):
            return BufferTooSmall(f"{layout.type_name} needs {size} bytes, the buffer has {len(buffer)}")
        _check_fields(layout, message)
    except FieldError as found:
        return found.with_traceback(None)
    return MessageError(f"{layout.type_name} cannot be encoded into this buffer: {error}")


def _check_fields(layout: MessageLayout, message: Any) -> None:
    """Raise the FieldError for a value in a message, or in a nested one, that does not fit."""
    for field in layout.fields:
        value = getattr(message, field.name)
        fit(f"{layout.type_name}.{field.schema_name}", field.type, value)
        kind, inner = (field.type.element, value) if isinstance(field.type, Items) else (field.type, [value])
        if isinstance(kind, Nested):
            for one in inner:
                _check_fields(kind.layout, one)
