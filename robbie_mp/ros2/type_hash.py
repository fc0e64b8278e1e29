"""Type hashes of ROS 2: SHA-256 of a type's description, with which nodes notice that a type has changed.

The description is a JSON text of the field names and types of a type, and of all types in it. Constants,
defaults and comments do not count.

Source: REP-2016, https://ros.org/reps/rep-2016.html; the numbers of the field types are those of
type_description_interfaces/msg/FieldType.
"""

import hashlib
import json
from typing import Any, Final

from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import fields_of
from robbie_mp.messages.schema import nested_types

PREFIX: Final = "RIHS01_"
NESTED: Final = 1
PRIMITIVES: Final = {
    "int8": 2,
    "uint8": 3,
    "char": 3,  # in ROS 2 a char is an unsigned number
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
}
STRING: Final = 17
BOUNDED_STRING: Final = 21
ARRAY: Final = 48
BOUNDED_SEQUENCE: Final = 96
SEQUENCE: Final = 144
FILLER: Final = "structure_needs_at_least_one_member"


def type_hash(message_type: type[Message]) -> str:
    """Return the hash of a type, as `RIHS01_` and 64 digits.

        >>> type_hash(Twist)
        'RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a'

    Args:
        message_type: the class of the messages.
    """
    nested = sorted(nested_types(message_type), key=lambda one: one.type_name)
    description = {
        "type_description": _describe(message_type),
        "referenced_type_descriptions": [_describe(one) for one in nested],
    }
    return PREFIX + hashlib.sha256(json.dumps(description).encode()).hexdigest()


def _describe(message_type: type[Message]) -> dict[str, Any]:
    fields = [_field(one.schema_name, one.type) for one in fields_of(message_type)]
    return {
        "type_name": message_type.type_name,
        "fields": fields or [_field(FILLER, Primitive("uint8", "B", 1, 0))],
    }


def _field(name: str, kind: FieldType) -> dict[str, Any]:
    element = kind.element if isinstance(kind, Numbers | Items) else kind
    capacity, several = 0, 0
    if isinstance(kind, Numbers | Items):
        capacity = kind.length or kind.max_length or 0
        several = ARRAY if kind.length else BOUNDED_SEQUENCE if kind.max_length else SEQUENCE
    return {
        "name": name,
        "type": {
            "type_id": _number(element) + several,
            "capacity": capacity,
            "string_capacity": (element.max_length or 0) if isinstance(element, Text) else 0,
            "nested_type_name": element.message.type_name if isinstance(element, Nested) else "",
        },
    }


def _number(kind: Primitive | Text | Nested) -> int:
    if isinstance(kind, Primitive):
        return PRIMITIVES[kind.name]
    if isinstance(kind, Text):
        return STRING if kind.max_length is None else BOUNDED_STRING
    return NESTED
