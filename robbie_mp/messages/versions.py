"""Converts messages of an older version to the version of this program.

A class at version 3 declares the steps from version 1 to 2 and from 2 to 3:

    class Battery(Message, name="team_msgs/msg/Battery", version=3, upgrades={
        1: Upgrade(percent_to_ratio, schema="float32 percent"),
        2: Upgrade(add_cell_count),
    }):
        ratio: float32
        cells: uint8

A step works on plain dictionaries (see `as_dict`), because older versions have no class. Old bytes are
decoded with the old schema, which the log contains; `schema` is for bytes without one.
"""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING, Generic, TypeVar

from robbie_mp.messages.declaration import Upgrade
from robbie_mp.messages.errors import VersionError
from robbie_mp.messages.field_types import Field, Items, Nested
from robbie_mp.messages.message import Message, fields_of
from robbie_mp.messages.plain import as_dict, from_dict
from robbie_mp.messages.schema import layout, schema_text
from robbie_mp.messages.schema_parser import message_type_from_schema

if TYPE_CHECKING:
    from typing_extensions import Buffer

_Message = TypeVar("_Message", bound=Message)


def decode_version(
    message_type: type[_Message], data: Buffer, version: int, schema: str | None = None
) -> _Message:
    """Decode bytes of any version of a message type, and convert them to the version of this program.

    Args:
        message_type: this program's class.
        data: the encoding.
        version: the version of the bytes.
        schema: the ros2msg text that came with the bytes; None if there was none.

    Raises:
        VersionError: the version is newer than the class, a step or the old schema is missing, a step fails,
            or the schema differs from the class of the same version.
        DecodeError: the bytes do not encode a message of this version.
        SchemaError: the schema text is invalid.
    """
    return VersionDecoder(message_type, version, schema).decode(data)


class VersionDecoder(Generic[_Message]):
    """Decodes many messages of one version, as `decode_version` does one.

    Args:
        message_type: this program's class.
        version: the version of the bytes.
        schema: the ros2msg text that came with the bytes; None if there was none.

    Raises:
        VersionError, SchemaError: as `decode_version`, except for errors of a single message.
    """

    def __init__(self, message_type: type[_Message], version: int, schema: str | None = None):
        self._type = message_type
        self._first = version
        ours = message_type.version
        if version > ours:
            raise VersionError(
                f"{message_type.type_name}: version {version} was written, {ours} is the newest here; "
                "update this program"
            )
        self._steps = [_step(message_type, number, version) for number in range(version, ours)]
        if not self._steps:
            _check_same_layout(message_type, schema)
            return
        schema = schema if schema is not None else self._steps[0].schema
        if schema is None:
            raise VersionError(
                f"{message_type.type_name}: version {version} came without a schema, the class declares "
                f"none; declare upgrades={{{version}: Upgrade(…, schema=…)}}"
            )
        self._written = message_type_from_schema(message_type.type_name, schema, version)

    def decode(self, data: Buffer) -> _Message:
        """Decode a message and convert it to the version of this program.

        Raises:
            VersionError: a step fails.
            DecodeError: the bytes do not encode a message of this version.
        """
        if not self._steps:
            return self._type.decode(data)
        fields = as_dict(self._written.decode(data))
        for number, upgrade in enumerate(self._steps, start=self._first):
            try:
                fields = upgrade.step(fields)
            except Exception as error:
                raise VersionError(
                    f"{self._type.type_name}: the step from version {number} to {number + 1} failed: "
                    f"{error!r}"
                ) from error
        return from_dict(self._type, fields)


def _step(message_type: type[Message], number: int, written: int) -> Upgrade:
    if number not in message_type._upgrades:
        raise VersionError(
            f"{message_type.type_name}: version {written} cannot become {message_type.version}: the step "
            f"from {number} to {number + 1} is missing; declare it in upgrades={{{number}: Upgrade(…)}}"
        )
    return message_type._upgrades[number]


def _check_same_layout(message_type: type[Message], schema: str | None) -> None:
    """Refuse a schema with another layout than the class of the same version."""
    if schema is not None and (difference := layout_difference(message_type, schema)):
        raise VersionError(
            f"{message_type.type_name}: what was written as version {message_type.version} has other fields "
            f"than the class ({difference}); raise the version when you change a message or one nested in it"
        )


def layout_difference(message_type: type[Message], schema: str) -> str:
    """Return the first field of a class that is not as in a schema; '' if they read each other's bytes.

    Raises:
        SchemaError: the schema text is invalid.
    """
    if schema == schema_text(message_type):
        return ""
    return _first_difference(message_type_from_schema(message_type.type_name, schema), message_type)


def _first_difference(before: type[Message], now: type[Message]) -> str:
    for number, (old, new) in enumerate(zip_longest(layout(before), layout(now))):
        if old == new:
            continue
        was, is_now = (fields_of(one)[number : number + 1] for one in (before, now))
        inner = [_nested_in(field) for field in (*was, *is_now)]
        if old and new and old[0] == new[0] and None not in inner:
            deeper = _first_difference(*filter(None, inner))
            if deeper:
                return f"{was[0].schema_name}: {deeper}"
        texts = [f"`{field[0].type} {field[0].schema_name}`" if field else "none" for field in (was, is_now)]
        return f"field {number + 1} was {texts[0]} and is {texts[1]} in the class"
    return ""


def _nested_in(field: Field) -> type[Message] | None:
    kind = field.type.element if isinstance(field.type, Items) else field.type
    return kind.message if isinstance(kind, Nested) else None
