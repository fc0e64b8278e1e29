"""Generates the functions of a message type."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from robbie_mp.messages.codec.constructor import write_constructor
from robbie_mp.messages.codec.decoder import write_decoder
from robbie_mp.messages.codec.encoder import write_encoder, write_loan_encoder
from robbie_mp.messages.codec.locate import find_failure
from robbie_mp.messages.codec.plan import plan_message
from robbie_mp.messages.codec.sizer import write_sizer
from robbie_mp.messages.codec.source import Source
from robbie_mp.messages.errors import BufferTooSmall, DecodeError, FieldError, MessageError
from robbie_mp.messages.field_types import Items, fields_of
from robbie_mp.messages.fitting import fit

if TYPE_CHECKING:
    from robbie_mp.messages.message import Message


def generate(message_type: type[Message], name: str) -> Callable[..., Any]:
    """Generate one of the functions of a message class, give it to the class, and return it.

    Its source stays readable: `inspect.getsource` and tracebacks find it, and `message_type._source` has it.

    Args:
        message_type: the class.
        name: `__new__`, `encoded_size`, `encode_into` or `decode`.
    """
    source = Source()
    fields = fields_of(message_type)
    match name:
        case "__new__":
            source.name("_fit", partial(_fit_field, message_type))
            write_constructor(source, message_type)
        case "encoded_size":
            source.name("_explain", _explain_encoding)
            write_sizer(source, plan_message(fields))
        case "encode_into":
            source.name("_explain", _explain_encoding)
            write_encoder(source, plan_message(fields))
        case "decode":
            source.name("_locate_failure", partial(_locate_failure, message_type))
            write_decoder(source, plan_message(fields), message_type)
    made: Callable[..., Any] = source.compile(
        f"<{name} of {message_type.type_name} version {message_type.version}>"
    )[name]
    made.__doc__ = getattr(message_type, name).__doc__
    made.__qualname__ = f"{message_type.__qualname__}.{name}"
    message_type._source[name] = source.text
    setattr(message_type, name, staticmethod(made) if name in ("__new__", "decode") else made)
    return made


LoanEncoder = Callable[["Message", memoryview, int], dict[str, Any]]


def loan_encoder(message_type: type[Message], loaned: frozenset[str]) -> LoanEncoder:
    """Return the function that encodes a message around the elements of the sequences named in `loaned`.

    It takes message, buffer and offset, and returns views of where these elements are, by name. It is
    generated when it is first needed, and kept by the class.
    """
    known = message_type._loan_encoders
    if loaned not in known:
        source = Source()
        source.name("_explain", _explain_encoding)
        write_loan_encoder(source, plan_message(fields_of(message_type)), loaned)
        made = source.compile(f"<loan of {', '.join(sorted(loaned))} of {message_type.type_name}>")
        known[loaned] = made["encode_around_loans"]
    return known[loaned]


def _fit_field(message_type: type[Message], name: str, value: object) -> Any:
    field = next(field for field in fields_of(message_type) if field.name == name)
    return fit(f"{message_type.type_name}.{field.schema_name}", field.type, value)


def _explain_encoding(message: Message, buffer: memoryview | None, error: Exception) -> Exception:
    """Return the error that says why a message could not be encoded."""
    try:
        if buffer is not None and len(buffer) < (size := message.encoded_size()):
            return BufferTooSmall(f"{message.type_name} needs {size} bytes, the buffer has {len(buffer)}")
        _check_fields(message)
    except FieldError as found:
        return found.with_traceback(None)
    return MessageError(f"{message.type_name} cannot be encoded into this buffer: {error}")


def _check_fields(message: Message) -> None:
    """Raise the FieldError for what does not fit in a message or in a nested one."""
    for field in fields_of(type(message)):
        value = getattr(message, field.name)
        fit(f"{message.type_name}.{field.schema_name}", field.type, value)
        for inner in value if isinstance(field.type, Items) else [value]:
            if hasattr(inner, "type_name"):
                _check_fields(inner)


def _locate_failure(message_type: type[Message], buffer: Any, error: Exception) -> Exception:
    """Return the error that says why bytes could not be decoded."""
    found = find_failure(message_type.type_name, fields_of(message_type), memoryview(buffer).cast("B"))
    return found or DecodeError(f"{message_type.type_name}: {error}")
