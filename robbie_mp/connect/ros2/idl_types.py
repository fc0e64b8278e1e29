"""Types for CycloneDDS made from declarations. They describe messages to others; the bytes pass unread."""

from typing import Any

from robbie_mp.connect.ros2.type_hash import FILLER
from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Nested, Primitive, Several
from robbie_mp.messages.message import fields_of


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
