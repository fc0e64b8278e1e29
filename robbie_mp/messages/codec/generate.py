"""Generates the functions of a message type from its layout.

Nothing is installed here: `message.py` gives the functions to the class.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from robbie_mp.messages.codec.constructor import write_constructor
from robbie_mp.messages.codec.decoder import write_decoder
from robbie_mp.messages.codec.encoder import write_encoder, write_loan_encoder
from robbie_mp.messages.codec.locate import find_failure
from robbie_mp.messages.codec.plan import plan_message
from robbie_mp.messages.codec.sizer import write_sizer
from robbie_mp.messages.codec.source import Source
from robbie_mp.messages.errors import BufferTooSmall, DecodeError, FieldError, MessageError
from robbie_mp.messages.field_types import Items, MessageLayout, Nested
from robbie_mp.messages.fitting import fit

LoanEncoder = Callable[[Any, memoryview, int], dict[str, Any]]


class Generated(NamedTuple):
    """A generated function and its source, which `inspect.getsource` and tracebacks also show."""

    function: Callable[..., Any]
    source: str


def generate(layout: MessageLayout, name: str) -> Generated:
    """Generate one of the functions of a message type.

    Args:
        layout: the type.
        name: `__new__`, `encoded_size`, `encode_into` or `decode`.
    """
    source = Source()
    match name:
        case "__new__":
            source.name("_fit", partial(_fit_field, layout))
            write_constructor(source, layout)
        case "encoded_size":
            source.name("_explain", partial(_explain_encoding, layout))
            write_sizer(source, plan_message(layout.fields))
        case "encode_into":
            source.name("_explain", partial(_explain_encoding, layout))
            write_encoder(source, plan_message(layout.fields))
        case "decode":
            source.name("_locate_failure", partial(_locate_failure, layout))
            write_decoder(source, plan_message(layout.fields), layout)
    made = source.compile(f"<{name} of {layout.type_name} version {layout.version}>")
    return Generated(made[name], source.text)


def generate_loan_encoder(layout: MessageLayout, loaned: frozenset[str]) -> LoanEncoder:
    """Generate the function that encodes a message except the elements of the sequences named in `loaned`.

    It takes message, buffer and offset, and returns views of where these elements are, by name.
    """
    source = Source()
    source.name("_explain", partial(_explain_encoding, layout))
    write_loan_encoder(source, plan_message(layout.fields), loaned)
    made = source.compile(f"<loan of {', '.join(sorted(loaned))} of {layout.type_name}>")
    encoder: LoanEncoder = made["encode_around_loans"]
    return encoder


def _fit_field(layout: MessageLayout, name: str, value: object) -> Any:
    field = next(field for field in layout.fields if field.name == name)
    return fit(f"{layout.type_name}.{field.schema_name}", field.type, value)


def _explain_encoding(
    layout: MessageLayout, message: Any, buffer: memoryview | None, error: Exception
) -> Exception:
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


def _locate_failure(layout: MessageLayout, buffer: Any, error: Exception) -> Exception:
    """Return the error that says why bytes could not be decoded."""
    found = find_failure(layout.type_name, layout.fields, memoryview(buffer).cast("B"))
    return found or DecodeError(f"{layout.type_name}: {error}")
