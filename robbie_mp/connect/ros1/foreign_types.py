"""Message types that only ROS 1 knows: classes made from the definitions that its connections carry.

A definition is the text of a type's file, as its author has written it. The texts of the types in it follow,
each behind a line of `=` and a line `MSG: package/Type`.

Source: https://wiki.ros.org/msg and
https://wiki.ros.org/ROS/Technical%20Overview#Message_serialization_and_msg_MD5_sums
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass, field
from typing import NamedTuple

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.ros1.conversion import ConversionError, Ros1Type
from robbie_mp.connect.ros1.definitions import BUILT_IN
from robbie_mp.messages import Message, MessageError
from robbie_mp.messages.descriptions import TypeDescription
from robbie_mp.messages.primitives import PRIMITIVES
from robbie_mp.messages.registry import full_name
from robbie_mp.messages.schema import SEPARATOR
from robbie_mp.messages.schema_parser import (
    KNOWN_ANYWAY,
    MAX_LINE_CHARACTERS,
    MAX_NESTING,
    MAX_TEXT_BYTES,
    NAME_LINE,
    SEPARATOR_LINE,
    message_type_from_schema,
)

MAX_FIELDS = 2000
"""Most fields of a type, with those of all types in it: the codec has something for each."""
MAX_TYPES = 256
"""Most types in a definition."""
MAX_VALUES = 1_000_000
"""Most values in the lists of messages and strings in a message, which become objects when it is checked."""
TYPE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}/[A-Za-z][A-Za-z0-9_]{0,99}")
FIELD = re.compile(
    r"(?P<base>[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)?)(?P<several>\[(?P<count>[0-9]{0,9})\])?\s+"
    r"(?P<name>[A-Za-z][A-Za-z0-9_]*)"
)
HEADER, HEADER_MD5 = "std_msgs/Header", "2176decaecbce78abc3b96ef049fabed"
HEADER_FIELDS = ("builtin_interfaces/Time stamp", "string frame_id")
"""A header's fields in the robot; ROS 1 has a sequence number before them."""
ROS2_NAMES = {"byte": "int8", "char": "uint8"} | {
    short: name.replace("/msg/", "/") for name, short in BUILT_IN.items()
}
"""Primitives of ROS 1 that are called otherwise in ROS 2, or are message types there."""
TIME_BYTES, LENGTH_BYTES = 8, 4


class DefinitionError(RobbieError, ValueError):
    """The robot cannot take messages of a type that it knows only from its definition in ROS 1.

    Example scenarios:
      - the MD5 sum is not that of the definition
      - the definition is incomplete, contains itself, or is beyond a limit
    """


class ForeignType(NamedTuple):
    """A type made from a definition of ROS 1.

    Attributes:
        kind: the type, which converts messages.
        description: the type as text, for programs that show or record its messages.
        max_bytes: size of the largest message that is taken.
    """

    kind: Ros1Type
    description: TypeDescription
    max_bytes: float

    @property
    def message_type(self) -> type[Message]:
        """The class of its messages."""
        return self.kind.message_type

    def from_ros1(self, data: bytes) -> bytes:
        """Return the encoding of a message that ROS 1 has serialised.

        Raises:
            ConversionError: the bytes are no message of this type, or there are too many of them.
        """
        if len(data) > self.max_bytes:
            raise ConversionError(
                f"{len(data)} bytes may be more than {MAX_VALUES} values in lists of messages and strings; "
                f"the limit for {self.kind.name} is {self.max_bytes:.0f} bytes"
            )
        return self.kind.from_ros1(data)


def foreign_type(name: str, md5: str, definition: str) -> ForeignType:
    """Make a type from its definition in ROS 1.

        gas = foreign_type("nose_msgs/Gas", "dfdda4cc91255659c096089d4e642926", "uint16 ppm")
        encoded = gas.from_ros1(bytes(2))

    Args:
        name: its name in ROS 1, such as `nose_msgs/Gas`.
        md5: the sum that came with the definition.
        definition: the text, with the texts of the types in it.

    Raises:
        DefinitionError: it is not the definition of that sum, is invalid or incomplete, or is beyond a limit.
    """
    if not TYPE_NAME.fullmatch(name):
        raise DefinitionError(f"{name!r:.200} is not the name of a type, such as 'nose_msgs/Gas'")
    if len(definition) > MAX_TEXT_BYTES:
        raise DefinitionError(f"its definition has more than {MAX_TEXT_BYTES} characters, which is the limit")
    if not definition.strip() and md5 != hashlib.md5(b"", usedforsecurity=False).hexdigest():
        raise DefinitionError("its publisher sends no definition")
    parser = _Parser(_texts(name, definition))
    own = parser.parse(name)
    if own.md5 != md5:
        raise DefinitionError(f"its definition has the MD5 sum {own.md5}, but its publisher says {md5!r:.40}")
    schema = parser.schema(name)
    try:
        made = message_type_from_schema(full_name(name), schema)
    except (MessageError, SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise DefinitionError(str(error)) from error
    max_bytes = own.bytes_of_value * MAX_VALUES
    kind = Ros1Type(name, md5, definition, made)
    return ForeignType(kind, TypeDescription(made.type_name, made.version, schema), max_bytes)


def _texts(name: str, definition: str) -> dict[str, str]:
    """Return the text of each type in a definition, by its name."""
    first, *others = SEPARATOR_LINE.split(definition)
    if len(others) >= MAX_TYPES:
        raise DefinitionError(f"its definition has more than {MAX_TYPES} types, which is the limit")
    texts: dict[str, str] = {}
    for other in others:
        named = NAME_LINE.match(f"{other}\n")
        if not named or not TYPE_NAME.fullmatch(named[1]):
            raise DefinitionError("there is no line 'MSG: package/Type' behind a separator in its definition")
        text = other[named.end() :]
        if texts.setdefault(named[1], text) != text or named[1] == name:
            raise DefinitionError(f"its definition has two texts of {named[1]}")
    return texts | {name: first}


class _Parsed(NamedTuple):
    """One type of a definition.

    Attributes:
        md5: its sum.
        lines: constants and fields in the robot's notation.
        fields: number of its fields, with those of the types in it.
        smallest: number of bytes of its smallest message in ROS 1.
        bytes_of_value: number of bytes that a value in any of its lists of messages and strings has at least.
    """

    md5: str
    lines: tuple[str, ...]
    fields: int
    smallest: int
    bytes_of_value: float


@dataclass
class _Parser:
    """Parses the types of a definition.

    Args:
        texts: of each type, by its name.
    """

    texts: dict[str, str]
    done: dict[str, _Parsed] = field(default_factory=dict)
    open: list[str] = field(default_factory=list)
    """The types that are being parsed, each within the one before it."""

    def schema(self, name: str) -> str:
        """Return what has been parsed as a schema of a type, with all types in it."""
        texts = {one: "".join(f"{line}\n" for line in parsed.lines) for one, parsed in self.done.items()}
        own = texts.pop(name)
        lines = [line for parsed in self.done.values() for line in parsed.lines]
        for one, text in KNOWN_ANYWAY.items():
            if any(line.startswith(one) for line in lines):
                texts[one] = f"{text}\n"
        return own + "".join(f"{SEPARATOR}\nMSG: {one}\n{text}" for one, text in texts.items())

    def parse(self, name: str) -> _Parsed:
        """Parse a type and the types in it."""
        if name in self.done:
            return self.done[name]
        if name in self.open:
            raise DefinitionError(f"{name} contains itself")
        if len(self.open) > MAX_NESTING:
            raise DefinitionError(f"it has messages nested more than {MAX_NESTING} deep, which is the limit")
        if name not in self.texts:
            raise DefinitionError(f"its definition has no text of {name}")
        if name in KNOWN_ANYWAY:
            raise DefinitionError(f"{name} is a type of ROS 2")
        self.open.append(name)
        parsed = self._parse(name)
        self.open.pop()
        self.done[name] = parsed
        return parsed

    def _parse(self, name: str) -> _Parsed:
        constants, sums, lines = [], [], []
        fields, smallest, bytes_of_value = 0, 0, float("inf")
        for line in self.texts[name].splitlines():
            content = line.partition("#")[0].strip()
            if not content:
                continue
            if len(line) > MAX_LINE_CHARACTERS:
                raise DefinitionError(f"{name}: a line has more than {MAX_LINE_CHARACTERS} characters")
            if "=" in content:
                summed, made = _constant(name, line, content)
                constants.append(summed)
                lines.append(made)
                continue
            one = self._field(name, content)
            sums.append(one.md5)
            lines.extend(one.lines)
            fields += one.fields
            smallest += one.smallest
            bytes_of_value = min(bytes_of_value, one.bytes_of_value)
            if fields > MAX_FIELDS:
                raise DefinitionError(f"it has more than {MAX_FIELDS} fields, which is the limit")
        md5 = hashlib.md5("\n".join((*constants, *sums)).encode(), usedforsecurity=False).hexdigest()
        if name == HEADER:
            if md5 != HEADER_MD5:
                raise DefinitionError(f"its {HEADER} is not ROS's")
            lines = list(HEADER_FIELDS)
        return _Parsed(md5, tuple(lines), fields, smallest, bytes_of_value)

    def _field(self, owner: str, content: str) -> _Parsed:
        """Return a field; its `md5` is its line in the text of which the owner's sum is taken."""
        parts = FIELD.fullmatch(content)
        if not parts:
            raise DefinitionError(f"{owner}: {content!r:.200} is not a field")
        base, several, field_name = parts["base"], parts["several"] or "", parts["name"]
        size = _smallest(base)
        if size is not None:
            kind, summed, inner = ROS2_NAMES.get(base, base), f"{base}{several}", None
        else:
            kind = self._full(owner, base, several)
            inner = self.parse(kind)
            size, summed = inner.smallest, inner.md5
        fields = 1 + (inner.fields if inner else 0)
        bytes_of_value = inner.bytes_of_value if inner else float("inf")
        if several:
            count = int(parts["count"]) if parts["count"] else None
            if not size or count == 0:
                raise DefinitionError(f"{owner}: {content!r:.200} is a list of nothing")
            if base not in PRIMITIVES:
                bytes_of_value = min(bytes_of_value, size / (inner.fields if inner else 1))
            size = LENGTH_BYTES if count is None else count * size
        line = f"{kind}{several} {field_name}"
        return _Parsed(f"{summed} {field_name}", (line,), fields, size, bytes_of_value)

    def _full(self, owner: str, base: str, several: str) -> str:
        """Return the full name of a message type that a line of another type names."""
        near = f"{owner.partition('/')[0]}/{base}"
        if base == "Header" and (not several or near not in self.texts):
            return HEADER
        return base if "/" in base else near


def _smallest(base: str) -> int | None:
    """Return the number of bytes that a primitive has at least; None: it is a message."""
    if base == "string":
        return LENGTH_BYTES
    if base in ("time", "duration"):
        return TIME_BYTES
    return PRIMITIVES[base].size if base in PRIMITIVES else None


def _constant(owner: str, line: str, content: str) -> tuple[str, str]:
    """Return a constant as its type's MD5 sum has it, and as a line of a schema."""
    base = content.split(maxsplit=1)[0]
    # In a string, everything behind the first = counts, also a #.
    left, _, value = (line if base == "string" else content).partition("=")
    words, value = left.split(), value.strip()
    try:
        if len(words) != 2:
            raise ValueError("expected 'type NAME=value'")
        return f"{base} {words[1]}={value}", f"{ROS2_NAMES.get(base, base)} {words[1]}={_value(base, value)}"
    except ValueError as error:
        raise DefinitionError(f"{owner}: {content!r:.200} is not a constant: {error}") from None


def _value(base: str, value: str) -> str:
    """Return a constant's value as it is written in a schema."""
    if base == "string":
        return json.dumps(value, ensure_ascii=False)
    if base == "bool":
        return "true" if value.lower() in ("true", "1") else "false"
    if base in ("float32", "float64"):
        return repr(float(value))
    if base not in PRIMITIVES:
        raise ValueError(f"{base!r:.200} has no constants")
    try:
        return str(int(value))
    except ValueError:
        return str(int(value, 0))
