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
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.messages.service_events import EVENT_INFO, EVENT_INFO_NAME

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
    return _hash(_describe(message_type), [_describe(one) for one in nested_types(message_type)])


def service_hash(name: str, request: type[Message], response: type[Message]) -> str:
    """Return the hash of a service's type, which covers its requests, its responses, and the events of both.

    Args:
        name: as `std_srvs/srv/Trigger`.
        request: the class of its requests.
        response: the class of its responses.
    """
    event_info = message_type_from_schema(EVENT_INFO_NAME, EVENT_INFO)
    parts = {one.type_name: one for one in (event_info, request, response)}
    for one in list(parts.values()):
        parts |= {nested.type_name: nested for nested in nested_types(one)}
    info, asked, answered = EVENT_INFO_NAME, request.type_name, response.type_name
    event = {
        "type_name": f"{name}_Event",
        "fields": [
            _nested_field("info", info),
            _nested_field("request", asked, several=BOUNDED_SEQUENCE, capacity=1),
            _nested_field("response", answered, several=BOUNDED_SEQUENCE, capacity=1),
        ],
    }
    service = {
        "type_name": name,
        "fields": [
            _nested_field("request_message", asked),
            _nested_field("response_message", answered),
            _nested_field("event_message", f"{name}_Event"),
        ],
    }
    return _hash(service, [event, *map(_describe, parts.values())])


def _hash(described: dict[str, Any], referenced: list[dict[str, Any]]) -> str:
    description = {
        "type_description": described,
        "referenced_type_descriptions": sorted(referenced, key=lambda one: str(one["type_name"])),
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
    if isinstance(element, Nested):
        return _nested_field(name, element.message.type_name, several, capacity)
    longest = (element.max_length or 0) if isinstance(element, Text) else 0
    return _typed_field(name, _number(element) + several, capacity, longest)


def _nested_field(name: str, type_name: str, several: int = 0, capacity: int = 0) -> dict[str, Any]:
    return _typed_field(name, NESTED + several, capacity, 0, type_name)


def _typed_field(name: str, number: int, capacity: int, longest: int, nested: str = "") -> dict[str, Any]:
    return {
        "name": name,
        "type": {
            "type_id": number,
            "capacity": capacity,
            "string_capacity": longest,
            "nested_type_name": nested,
        },
    }


def _number(kind: Primitive | Text) -> int:
    if isinstance(kind, Primitive):
        return PRIMITIVES[kind.name]
    return STRING if kind.max_length is None else BOUNDED_STRING
