"""Names of frames in messages: the text fields called `frame_id` and `child_frame_id`, at any depth."""

from collections.abc import Callable
from functools import cache
from struct import Struct
from typing import TypeVar

from robbie_mp.messages.field_types import FieldType, Items, Nested, Text
from robbie_mp.messages.message import Message, fields_of, replace

FRAME_FIELDS = ("frame_id", "child_frame_id")
HEADER = "std_msgs/msg/Header"
_LENGTH = Struct("<I")
_LENGTH_AT, _NAME_AT = 12, 16
"""Where a message that begins with a header has the frame's name: behind the encapsulation and the stamp."""
_SLASH_IN_FRONT = b"\0/"
"""The last byte of a text's length, which is 0 in any message of at most 16 MiB, and a slash."""

MessageType = TypeVar("MessageType", bound=Message)
Data = bytes | memoryview
Rename = Callable[[Data], Data]
"""Takes an encoded message, and returns it with other names of frames."""


def without_slash(name: str) -> str:
    """Return the name of a frame without the slash that ROS 1 puts before it: `/map` is `map`."""
    return name.lstrip("/")


def renamer(
    message_type: type[Message], name_of: Callable[[str], str], *, is_only_slash: bool = False
) -> Rename:
    """Return what renames the frames in encoded messages of a type.

    It raises a `MessageError` if the bytes are no such message.

    Args:
        message_type: the type.
        name_of: returns the new name for an old one.
        is_only_slash: `name_of` changes only names that begin with a slash.
    """
    return _Renamer(message_type, name_of, is_only_slash) if has_frames(message_type) else unchanged


def has_frames(message_type: type[Message]) -> bool:
    """Return whether messages of a type, or messages in them, name frames."""
    return bool(_framed(message_type))


class _Renamer:
    """Renames the frames in encoded messages of a type.

    Where only the header in front names a frame, as in scans and images, a message whose frame keeps its name
    is not decoded; nor is one without a slash at the beginning of a text, where slashes alone are taken away.
    """

    def __init__(self, message_type: type[Message], name_of: Callable[[str], str], is_only_slash: bool):
        self._type, self._name_of, self._is_only_slash = message_type, name_of, is_only_slash
        first = fields_of(message_type)[0]
        is_header = isinstance(first.type, Nested) and first.type.layout.type_name == HEADER
        self._is_only_in_front = is_header and _framed(message_type) == (first.name,)

    def __call__(self, data: Data) -> Data:
        if self._is_only_in_front and len(data) > _NAME_AT:
            (length,) = _LENGTH.unpack_from(data, _LENGTH_AT)
            name = bytes(data[_NAME_AT : _NAME_AT + length - 1]).decode("utf-8", "replace")
            if self._name_of(name) == name:
                return data
        elif self._is_only_slash and _SLASH_IN_FRONT not in bytes(data):
            return data
        message = self._type.decode(data)
        changed = renamed(message, self._name_of)
        if changed is message:
            return data
        buffer = bytearray(changed.encoded_size())
        changed.encode_into(memoryview(buffer))
        return memoryview(buffer)


def renamed(message: MessageType, name_of: Callable[[str], str]) -> MessageType:
    """Return a message with other names of frames; the message itself if none changes.

    Args:
        message: any message; it does not change.
        name_of: returns the new name for an old one.
    """
    changes = {}
    for field in _framed(type(message)):
        value = getattr(message, field)
        new = _renamed_value(value, name_of)
        if new is not value:
            changes[field] = new
    return replace(message, **changes) if changes else message


def _renamed_value(value: object, name_of: Callable[[str], str]) -> object:
    if isinstance(value, str):
        name = name_of(value)
        return value if name == value else name
    if isinstance(value, list):
        items = [_renamed_value(one, name_of) for one in value]
        return items if any(new is not old for new, old in zip(items, value, strict=True)) else value
    assert isinstance(value, Message)
    return renamed(value, name_of)


@cache
def _framed(message_type: type[Message]) -> tuple[str, ...]:
    """Return the names of the fields that are names of frames, or have such fields inside."""
    return tuple(
        field.name
        for field in fields_of(message_type)
        if (isinstance(field.type, Text) and field.schema_name in FRAME_FIELDS) or _has_frames(field.type)
    )


def _has_frames(kind: FieldType) -> bool:
    element = kind.element if isinstance(kind, Items) else kind
    if not isinstance(element, Nested):
        return False
    inner: type[Message] = element.message
    return bool(_framed(inner))


def unchanged(data: Data) -> Data:
    """Return the message as it is."""
    return data
