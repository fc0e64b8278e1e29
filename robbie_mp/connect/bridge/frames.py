"""Frames of the robot that have other names on the other side of a bridge.

The setting `frames` of a bridge says what the robot's frames are called there:

    frames:
      map: map
      "*": red/{frame}

A frame that is named counts before `*`, which stands for all others. The bridge renames what leaves the
robot, and turns the names back in what comes in: in each text field called `frame_id` or `child_frame_id`,
at any depth. An empty name stays empty.
"""

import re
from collections.abc import Callable, Mapping
from functools import cache
from struct import Struct

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.bridge.mapping import MappingError
from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Items, Nested, Text
from robbie_mp.messages.message import fields_of, replace

MAX_FRAMES = 256
"""Most frames that a profile may rename one by one."""
OTHERS, FRAME = "*", "{frame}"
FRAME_FIELDS = ("frame_id", "child_frame_id")
HEADER = "std_msgs/msg/Header"
FRAME_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]*")
_LENGTH = Struct("<I")
_LENGTH_AT, _NAME_AT = 12, 16
"""Where a message that begins with a header has the frame's name: behind the encapsulation and the stamp."""

Data = bytes | memoryview
Rename = Callable[[Data], Data]
"""Takes an encoded message, and returns it with other names of frames."""


class ForeignFrame(RobbieError, ValueError):
    """A message is about a frame of the other side that the robot does not have.

    Example: the robot's `map` is `red/map` in ROS, and a goal comes in the frame `map`.
    """


class FrameMap:
    """What the robot's frames are called on the other side of a bridge.

        frames = FrameMap({"map": "map", "*": "red/{frame}"})
        assert frames.name_there("base_link") == "red/base_link"
        assert frames.name_here("red/base_link") == "base_link"

    Args:
        frames: the setting of that name; see above. Empty: every frame has the same name on both sides.

    Raises:
        MappingError: a line is wrong, or two frames would have the same name.
    """

    def __init__(self, frames: Mapping[str, str]):
        self._there = {name: other for name, other in frames.items() if name != OTHERS}
        self._here = {other: name for name, other in self._there.items()}
        self._before, self._after = "", ""
        self._has_others = OTHERS in frames
        problems = [
            f"{name!r}: {other!r} is not a name of a frame, such as 'red/map'"
            for name, other in self._there.items()
            if not (FRAME_NAME.fullmatch(name) and FRAME_NAME.fullmatch(other))
        ]
        if len(frames) > MAX_FRAMES:
            problems.append(f"there are {len(frames)} frames; at most {MAX_FRAMES} can be named")
        if len(self._here) < len(self._there):
            problems.append("two frames have the same name on the other side")
        if self._has_others:
            self._before, found, self._after = frames[OTHERS].partition(FRAME)
            if not (found and FRAME_NAME.fullmatch(frames[OTHERS].replace(FRAME, "frame", 1))):
                problems.append(f"'*': expected a name with {FRAME} in it, such as 'red/{FRAME}'")
        if problems:
            raise MappingError("\n".join(problems))
        for name, other in self._there.items():
            same = self._unwrapped(other)
            if same is not None and same not in self._there:
                raise MappingError(f"{name!r}: with '*', {same!r} is called {other!r}, too")

    def name_there(self, name: str) -> str:
        """Return what a frame of the robot is called on the other side."""
        found = self._there.get(name)
        if found is None:
            return f"{self._before}{name}{self._after}" if self._has_others and name else name
        return found

    def name_here(self, name: str) -> str:
        """Return what the robot calls a frame of the other side.

        Raises:
            ForeignFrame: it means another frame on the robot, or with `*` none.
        """
        found = self._here.get(name) or self._unwrapped(name)
        if found is not None and self.name_there(found) == name:
            return found
        if name and (self._has_others or name in self._there):
            raise ForeignFrame(f"the robot has no frame that is called {name!r:.80} there")
        return name

    def outward(self, message_type: type[Message]) -> Rename:
        """Return what renames the frames in messages of a type that leave the robot."""
        return self._renamer(message_type, self.name_there)

    def inward(self, message_type: type[Message]) -> Rename:
        """Return what renames the frames in messages of a type that come in.

        It raises a `MessageError` if the bytes are no such message, and `ForeignFrame` as `name_here` does.
        """
        return self._renamer(message_type, self.name_here)

    def _renamer(self, message_type: type[Message], name_of: Callable[[str], str]) -> Rename:
        if not (self._there or self._has_others) or not _framed(message_type):
            return _unchanged
        return _Renamer(message_type, name_of)

    def _unwrapped(self, name: str) -> str | None:
        """Return the robot's name of what `*` has renamed; None: it has not."""
        inside = name.removeprefix(self._before).removesuffix(self._after)
        fits = self._has_others and inside and len(inside) == len(name) - len(self._before + self._after)
        return inside if fits else None


class _Renamer:
    """Renames the frames in encoded messages of a type.

    Where only the header in front names a frame, as in scans and images, a message whose frame keeps its name
    is not decoded.
    """

    def __init__(self, message_type: type[Message], name_of: Callable[[str], str]):
        self._type, self._name_of = message_type, name_of
        first = fields_of(message_type)[0]
        is_header = isinstance(first.type, Nested) and first.type.layout.type_name == HEADER
        self._is_only_in_front = is_header and _framed(message_type) == (first.name,)

    def __call__(self, data: Data) -> Data:
        if self._is_only_in_front and len(data) > _NAME_AT:
            (length,) = _LENGTH.unpack_from(data, _LENGTH_AT)
            name = bytes(data[_NAME_AT : _NAME_AT + length - 1]).decode("utf-8", "replace")
            if self._name_of(name) == name:
                return data
        message = self._type.decode(data)
        changed = renamed(message, self._name_of)
        if changed is message:
            return data
        buffer = bytearray(changed.encoded_size())
        changed.encode_into(memoryview(buffer))
        return memoryview(buffer)


def renamed(message: Message, name_of: Callable[[str], str]) -> Message:
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


def _unchanged(data: Data) -> Data:
    return data
