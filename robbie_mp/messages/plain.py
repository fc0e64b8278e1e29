"""Converts messages to plain dictionaries and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages.errors import FieldError, FieldTypeError
from robbie_mp.messages.field_types import FieldType, Items, Nested
from robbie_mp.messages.message import Message, fields_of

_Message = TypeVar("_Message", bound=Message)


def as_dict(message: Message) -> dict[str, Any]:
    """Return the fields of a message by name; nested messages become dictionaries, arrays stay."""
    return {field.name: _plain(getattr(message, field.name)) for field in fields_of(type(message))}


def _plain(value: Any) -> Any:
    if isinstance(value, Message):
        return as_dict(value)
    return [_plain(item) for item in value] if isinstance(value, list) else value


def from_dict(message_type: type[_Message], fields: Mapping[str, Any]) -> _Message:
    """Return the message with these fields; nested messages may be given as dictionaries.

    Raises:
        FieldError: there is no such field, or a value does not fit.
    """
    return _build(message_type, fields, "")


def _build(message_type: type[_Message], fields: Mapping[str, Any], path: str) -> _Message:
    where = f"{path}: " if path else ""
    kinds = {field.name: field.type for field in fields_of(message_type)}
    for name in fields:
        if name not in kinds:
            near = did_you_mean(name, kinds)
            raise FieldTypeError(f"{where}{message_type.type_name} has no field {name!r}{near}")
    typed = {
        name: _typed(kinds[name], value, f"{path}.{name}" if path else name) for name, value in fields.items()
    }
    try:
        return message_type(**typed)
    except FieldError as error:
        raise type(error)(f"{where}{error}") from None


def _typed(kind: FieldType, value: Any, path: str) -> Any:
    if isinstance(kind, Nested) and isinstance(value, Mapping):
        return _build(kind.message, value, path)
    if isinstance(kind, Items) and isinstance(value, list):
        return [_typed(kind.element, item, f"{path}[{index}]") for index, item in enumerate(value)]
    return value
