"""The units of a type's fields, as the comments beside its fields state them."""

import inspect
import re

from robbie_mp.messages.field_types import FieldType, Nested, Numbers, Primitive
from robbie_mp.messages.message import Message, fields_of, nested
from robbie_mp.messages.registry import TypeRegistry, full_name
from robbie_mp.messages.schema import SEPARATOR

Comments = dict[str, dict[str, str]]
"""Of each type, by its name: the unit of each of its fields that has one."""
_UNIT = (
    r"(?:\((?:rad/s|m/s\^2|m/s)\)\^2|rad/s\^2|m/s\^2|rad/s|m/s|m\^2|m\^3|rad\^2|rad|deg|degrees|pixels|m|mm|ns|us|ms|s"
    r"|kg|Nm|N|Hz|bytes|Pa|K|°C|T|V|Ah|A|W|lux|%)"
)
_OURS = re.compile(
    rf"(?:\([^()]*\) |row-major [^,]*, )?({_UNIT}(?: or {_UNIT})?)"
    r"(?=$|[,;:]| (?:above|after|between|from|of|since)\b)"
)
"""How our comments begin: `(N,) m`, `rad, of the first ray`."""
_OF_ROS = re.compile(rf"\[({_UNIT})\]")
"""As in comments of ROS: `start angle of the scan [rad]`."""
_OUR_FIELD = re.compile(r"^\s+(\w+): [^#\n]*#\s*(.+)$", re.MULTILINE)
_ROS_FIELD = re.compile(r"^[\w/<>=\[\]]+[ \t]+(\w+)[^#\n]*#(.+)$", re.MULTILINE)


def units(message_type: type[Message], schema: str, ours: TypeRegistry) -> dict[str, str]:
    """Return the units of the columns of a message type by their dotted names; others are not in it.

    Args:
        message_type: the type, which may be made from the schema.
        schema: its ros2msg text, whose comments may state units.
        ours: the types whose classes state units.
    """
    found: dict[str, str] = {}
    _add(found, nested(message_type), "", "", _of_schema(message_type, schema), ours)
    return found


def _add(
    found: dict[str, str], kind: FieldType, name: str, unit: str, comments: Comments, ours: TypeRegistry
) -> None:
    if isinstance(kind, Nested):
        of_type = _of_class(kind.message, ours) | comments.get(kind.message.type_name, {})
        for field in fields_of(kind.message):
            inner = f"{name}.{field.name}" if name else field.name
            _add(found, field.type, inner, unit or of_type.get(field.schema_name, ""), comments, ours)
    elif unit and isinstance(kind, Primitive | Numbers):
        found[name] = unit


def _of_class(message_type: type[Message], ours: TypeRegistry) -> dict[str, str]:
    """Return the units that the comments of our class of that name state."""
    if message_type.type_name not in ours:
        return {}
    try:
        source = inspect.getsource(ours.get(message_type.type_name))
    except (OSError, TypeError):  # without its source
        return {}
    stated = {name: _OURS.match(comment) for name, comment in _OUR_FIELD.findall(source)}
    return {name: match[1] for name, match in stated.items() if match}


def _of_schema(message_type: type[Message], schema: str) -> Comments:
    first, *others = schema.split(f"{SEPARATOR}\n")
    texts = {message_type.type_name: first}
    for other in others:
        head, _, text = other.partition("\n")
        texts[full_name(head.removeprefix("MSG:").strip())] = text
    return {name: _bracketed(text) for name, text in texts.items()}


def _bracketed(text: str) -> dict[str, str]:
    stated = {name: _OF_ROS.search(comment) for name, comment in _ROS_FIELD.findall(text)}
    return {name: match[1] for name, match in stated.items() if match}
