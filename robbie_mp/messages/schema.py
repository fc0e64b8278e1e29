"""Writes the ros2msg text of a message type, as contained in MCAP files.

Source: https://mcap.dev/spec/registry#ros2msg; the definitions themselves are described in
https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from robbie_mp.messages.declaration import Constant
from robbie_mp.messages.field_types import (
    DEFAULT,
    Field,
    FieldType,
    Items,
    Nested,
    Numbers,
    Primitive,
    Text,
    short_name,
)
from robbie_mp.messages.message import Message, fields_of

SEPARATOR = "=" * 80
DEFAULT_IN_COMMENT = "  # default: "
"""Stands before a default that is no finite number."""


def schema_text(message_type: type[Message]) -> str:
    """Return the definition of a type, followed by those of all types nested in it."""
    nested = (
        f"{SEPARATOR}\nMSG: {short_name(inner.type_name)}\n{own_definition(inner)}"
        for inner in nested_types(message_type)
    )
    return "".join((own_definition(message_type), *nested))


def nested_types(message_type: type[Message]) -> list[type[Message]]:
    """Return all types nested in a type, each once, in the order of their first occurrence."""
    found: dict[str, type[Message]] = {}
    for inner in _directly_nested(message_type):
        for one in (inner, *nested_types(inner)):
            found.setdefault(one.type_name, one)
    return list(found.values())


def layout(message_type: type[Message]) -> tuple[tuple[str, Any], ...]:
    """Return names and encodings of all fields: two types with equal layouts read each other's bytes.

    Capitals do not count: ROS 2 has renamed D, K, R and P of ROS 1's CameraInfo to d, k, r and p.
    """
    return tuple((field.schema_name.casefold(), _shape(field.type)) for field in fields_of(message_type))


def _shape(kind: FieldType) -> Any:
    match kind:
        case Primitive():
            return kind.code
        case Text():
            return "string"
        case Nested():
            return layout(kind.message)
        case Numbers() | Items():
            return _shape(kind.element), kind.length


def _directly_nested(message_type: type[Message]) -> Iterator[type[Message]]:
    for field in fields_of(message_type):
        kind: FieldType = field.type.element if isinstance(field.type, Items) else field.type
        if isinstance(kind, Nested):
            yield kind.message


def own_definition(message_type: type[Message]) -> str:
    """Return the definition of a type without those of the types in it."""
    constants = {one.name: _constant_line(one) for one in message_type._constants}
    lines = constants | {one.name: _field_line(one) for one in fields_of(message_type)}
    bases = [one for one in reversed(message_type.__mro__) if issubclass(one, Message)]
    declared = dict.fromkeys(name for one in bases for name in one.__annotations__ if name in lines)
    return "".join(f"{lines[name]}\n" for name in declared | lines)


def _constant_line(constant: Constant) -> str:
    return f"{constant.type} {constant.name}={_literal(constant.value)}"


def _field_line(field: Field) -> str:
    return f"{field.type} {field.schema_name}{_default(field)}"


def _default(field: Field) -> str:
    """Return the default as written in a definition; "" if there is none, or it has no notation.

    Readers of definitions know no literal for NaN and infinity, so these stand in a comment.
    """
    kind, value = field.type, field.declared_default
    if value is DEFAULT or isinstance(kind, Nested) or isinstance(getattr(kind, "element", None), Nested):
        return ""
    if isinstance(kind, Primitive) and isinstance(value, float) and not math.isfinite(value):
        return f"{DEFAULT_IN_COMMENT}{value}"
    return f" {_literal(value)}"


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # its escapes are also those of definitions
    if isinstance(value, np.ndarray):
        return _literal(value.tolist())
    if isinstance(value, list):
        return f"[{', '.join(map(_literal, value))}]"
    return repr(value)
