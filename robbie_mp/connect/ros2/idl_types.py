"""Types and topics for CycloneDDS made from declarations; the bytes of messages pass unread."""

import ctypes
from functools import cache
from typing import Any, Final

from robbie_mp.connect.ros2.type_hash import FILLER
from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Nested, Primitive, Several
from robbie_mp.messages.message import fields_of

OPERATIONS: Final = 14
"""Pointers in a `ddsi_sertype_ops` of CycloneDDS, of which the first is its version."""
TYPE_OPERATIONS: Final = (8, 9, 10)
"""Those that return a type's identifier, its map, and its information."""


def topic_of(participant: Any, name: str, raw: Any) -> Any:
    """Return a topic whose endpoints others match by its type's name, as nodes of ROS 2 do.

    CycloneDDS also compares the structure of both types if both sides tell it. FastDDS of ROS 2 Kilted
    tells it in a form that CycloneDDS does not understand, so endpoints with lists of messages would never
    match. As rmw_cyclonedds, this side tells no structure.

    Args:
        participant: the participant.
        name: the topic's name in DDS.
        raw: a `raw_type`.
    """
    from cyclonedds.topic import Topic  # noqa: PLC0415

    topic = Topic(participant, name, raw)
    library = _library()
    found = ctypes.POINTER(ctypes.c_void_p)()
    if library.dds_get_entity_sertype(topic._ref, ctypes.byref(found)) == 0:
        own = _without_structure(found[0] or 0)
        if own is not None:
            found[0] = ctypes.addressof(own)
    return topic


@cache
def _library() -> Any:
    from cyclonedds.__library__ import library_path  # noqa: PLC0415

    return ctypes.CDLL(str(library_path))


@cache
def _without_structure(operations: int) -> Any:
    """Return a copy of a type's operations that tells no structure; None if they are of another version."""
    array = ctypes.c_void_p * OPERATIONS
    version = ctypes.cast(_library().ddsi_sertype_v0, ctypes.c_void_p).value
    if not operations or ctypes.c_void_p.from_address(operations).value != version:
        return None
    copy = array.from_buffer_copy(array.from_address(operations))
    for one in TYPE_OPERATIONS:
        copy[one] = None
    return copy


def raw_type(message_type: type[Message]) -> Any:
    """Return a type of CycloneDDS whose samples are the encoded messages in `raw`.

    Args:
        message_type: the class of the messages.
    """
    made = _struct(message_type)

    def serialize(sample: Any, **_options: object) -> bytes:
        data: bytes = sample.raw
        return data

    def deserialize(data: bytes, **_options: object) -> Any:
        return sample_of(made, data)

    made.serialize = serialize
    made.deserialize = staticmethod(deserialize)
    return made


def sample_of(raw: Any, data: bytes) -> Any:
    """Return a sample of a `raw_type`."""
    sample = object.__new__(raw)
    sample.raw = data
    return sample


def _struct(message_type: type[Message]) -> Any:
    from cyclonedds.idl import make_idl_struct  # noqa: PLC0415 - an extra
    from cyclonedds.idl.types import uint8  # noqa: PLC0415

    package, kind, name = message_type.type_name.split("/")
    fields = {one.schema_name: _type(one.type) for one in fields_of(message_type)}
    return make_idl_struct(
        f"{name}_",
        f"{package}::{kind}::dds_::{name}_",
        fields or {FILLER: uint8},
        bases=(),
    )


def _type(kind: FieldType) -> Any:
    from cyclonedds.idl import types  # noqa: PLC0415

    if isinstance(kind, Several):
        element = _type(kind.element)
        if kind.length is not None:
            return types.array[element, kind.length]
        return (
            types.sequence[element] if kind.max_length is None else types.sequence[element, kind.max_length]
        )
    if isinstance(kind, Nested):
        return _struct(kind.message)
    if isinstance(kind, Primitive):
        return {"bool": bool, "char": types.uint8}.get(kind.name) or getattr(types, kind.name)
    return str if kind.max_length is None else types.bounded_str[kind.max_length]
