"""The ROS 1 definition of a message type, and the MD5 sum by which ROS 1 nodes compare definitions.

Source: https://wiki.ros.org/ROS/Technical%20Overview#Message_serialization_and_msg_MD5_sums
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

from robbie_mp.messages.declaration import Constant
from robbie_mp.messages.field_types import Field, FieldType, Items, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import Message, fields_of
from robbie_mp.messages.schema import SEPARATOR, nested_types

BUILT_IN = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}
"""Message types of ROS 2 that are primitives in ROS 1."""
HEADER = "std_msgs/msg/Header"
"""In ROS 1 it begins with a sequence number."""

_RENAMED = {"sensor_msgs/msg/CameraInfo": {"d": "D", "k": "K", "r": "R", "p": "P"}}
"""Fields that have other names in ROS 1."""
_LATER = {
    "sensor_msgs/msg/NavSatStatus": ("STATUS_UNKNOWN", "SERVICE_UNKNOWN"),
    "sensor_msgs/msg/BatteryState": (
        "POWER_SUPPLY_TECHNOLOGY_TERNARY",
        "POWER_SUPPLY_TECHNOLOGY_VRLA",
    ),
}
"""Constants that ROS 1 does not have; they count for the MD5 sum."""


def ros1_name(type_name: str) -> str:
    """Return the name of a type in ROS 1: `sensor_msgs/LaserScan` for `sensor_msgs/msg/LaserScan`."""
    package, _, name = type_name.split("/")
    return f"{package}/{name}"


def definition(message_type: type[Message]) -> str:
    """Return the definition of a type, followed by those of all types nested in it."""
    nested = (
        f"{SEPARATOR}\nMSG: {ros1_name(inner.type_name)}\n{_own_definition(inner)}"
        for inner in nested_types(message_type)
        if inner.type_name not in BUILT_IN
    )
    return "".join((_own_definition(message_type), *nested))


def md5(message_type: type[Message]) -> str:
    """Return the MD5 sum of a type: of its constants, then its fields, with sums in place of nested types."""
    lines = (*_constant_lines(message_type), *_field_lines(message_type, _name_in_sum))
    return hashlib.md5("\n".join(lines).encode(), usedforsecurity=False).hexdigest()


def _own_definition(message_type: type[Message]) -> str:
    lines = (*_constant_lines(message_type), *_field_lines(message_type, _name))
    return "".join(f"{line}\n" for line in lines)


def _constant_lines(message_type: type[Message]) -> Iterator[str]:
    later = _LATER.get(message_type.type_name, ())
    for constant in message_type._constants:
        if constant.name not in later:
            yield f"{_name(constant.type)} {constant.name}={_literal(constant)}"


def _literal(constant: Constant) -> str:
    return str(int(constant.value) if isinstance(constant.value, bool) else constant.value)


def _field_lines(message_type: type[Message], name_of: Any) -> Iterator[str]:
    if message_type.type_name == HEADER:
        yield "uint32 seq"
    for field in fields_of(message_type):
        yield f"{name_of(field.type)} {_field_name(message_type, field)}"


def _field_name(message_type: type[Message], field: Field) -> str:
    renamed = _RENAMED.get(message_type.type_name, {})
    return renamed.get(field.schema_name, field.schema_name)


def _name(kind: FieldType) -> str:
    """Return how a field type is written in ROS 1, which has no bounds."""
    match kind:
        case Primitive():
            return kind.name
        case Text():
            return "string"
        case Nested():
            return BUILT_IN.get(kind.layout.type_name) or ros1_name(kind.layout.type_name)
        case Numbers() | Items():
            return f"{_name(kind.element)}[{kind.length or ''}]"


def _name_in_sum(kind: FieldType) -> str:
    element = kind.element if isinstance(kind, Items) else kind
    if isinstance(element, Nested) and element.layout.type_name not in BUILT_IN:
        return md5(element.message)
    return _name(kind)
