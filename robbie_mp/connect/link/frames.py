"""Puts a robot's name before the names of the frames in its messages, for one scene graph of all robots."""

from collections.abc import Callable
from functools import cache
from typing import Any

from robbie_mp.messages import Message, replace
from robbie_mp.messages.field_types import Items, MessageLayout, Nested, Text
from robbie_mp.messages.message import fields_of, nested

FRAME_FIELDS = frozenset({"frame_id", "child_frame_id"})
"""Names of the fields that hold the name of a frame, as in ROS."""


def has_frames(message_type: type[Message]) -> bool:
    """Return whether messages of a type, or messages in them, name frames.

    Args:
        message_type: the type.
    """
    return _names_frames(nested(message_type).layout)


def prefixed(message: Message, prefix: str) -> Message:
    """Return a message in which each name of a frame begins with a prefix; empty names stay empty.

        prefixed(odometry, "red/").child_frame_id == "red/base_link"

    Args:
        message: the message; it does not change.
        prefix: the robot's name and a slash.
    """
    return _with(message, lambda name: name if not name or name.startswith(prefix) else prefix + name)


def _with(message: Message, named: Callable[[str], str]) -> Message:
    changes: dict[str, Any] = {}
    for field in fields_of(type(message)):
        kind, value = field.type, getattr(message, field.name)
        if isinstance(kind, Text) and field.name in FRAME_FIELDS:
            changes[field.name] = named(value)
        elif isinstance(kind, Nested) and _names_frames(kind.layout):
            changes[field.name] = _with(value, named)
        elif (
            isinstance(kind, Items)
            and isinstance(kind.element, Nested)
            and _names_frames(kind.element.layout)
        ):
            changes[field.name] = [_with(one, named) for one in value]
    return replace(message, **changes) if changes else message


@cache
def _names_frames(layout: MessageLayout) -> bool:
    for field in layout.fields:
        kind = field.type.element if isinstance(field.type, Items) else field.type
        if isinstance(kind, Text) and field.name in FRAME_FIELDS:
            return True
        if isinstance(kind, Nested) and _names_frames(kind.layout):
            return True
    return False
