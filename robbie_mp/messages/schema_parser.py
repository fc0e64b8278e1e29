"""Creates message types from ros2msg texts, for logs with types that this program does not declare.

Source of the grammar: https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, NamedTuple, cast

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages.declaration import TAKEN_NAMES, python_name
from robbie_mp.messages.errors import MessageError, SchemaError
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Text, short_name
from robbie_mp.messages.message import Message, MessageType, nested
from robbie_mp.messages.primitives import PRIMITIVES

SEPARATOR_LINE = re.compile(r"^={3,}\s*$", re.MULTILINE)
NAME_LINE = re.compile(r"\s*MSG:\s*(\S+)\s*\n")
COMMENT = re.compile(r"""("(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')|\#.*""")
LINE = re.compile(r"(?P<type>\S+)\s+(?P<name>[A-Za-z]\w*)(?:\s*=\s*(?P<constant>.*)|\s+(?P<default>.*))?")
TYPE = re.compile(r"(?P<base>[\w/]+)(?:<=(?P<text>\d+))?(?P<several>\[(?P<bounded><=)?(?P<count>\d*)\])?")
MAX_TEXT_BYTES = 256 << 10
"""Longest definition with all types in it, including comments."""
MAX_LINE_CHARACTERS = 4096
MAX_FIELDS = 5000
"""Most fields of a message with all nested messages: the codec has something for each of them."""
MAX_NESTING = 16
"""Deepest nesting of messages: the codec calls itself for each."""
MAX_FIXED_BYTES = 64 << 20
"""Largest message with empty sequences: the memory that a message takes before any field is set."""
OBJECT_BYTES = 64
"""Approximate size of a number, a str or an empty message in Python."""
KNOWN_ANYWAY = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
"""Definitions that some writers leave out, because they are built in there."""

NOT_FINITE = ("nan", "inf", "infinity")
"""Values of floats that Python does not know as literals."""
DEFAULT_COMMENT = re.compile(r"[^#\"']+\S[ ]{2}# default: (?P<value>nan|-?inf)")
"""A field whose default readers of definitions cannot express; see `schema.DEFAULT_IN_COMMENT`."""


def message_type_from_schema(type_name: str, text: str, version: int = 1) -> type[Message]:
    """Create a message class from a ros2msg text.

    Args:
        type_name: full name, such as `sensor_msgs/msg/LaserScan`.
        text: its definition and those of the types in it, as `schema_text` returns them.
        version: the version of the new class.

    Raises:
        SchemaError: the text is invalid or incomplete, uses wstring, which the decoders do not support, or
            describes a message beyond the limits of number of fields, nesting or size: a text of 2 kB can
            describe a message with more fields than fit into memory.
    """
    if len(text) > MAX_TEXT_BYTES:
        raise SchemaError(
            f"{type_name}: its schema has {len(text)} characters; the limit is {MAX_TEXT_BYTES}"
        )
    first, *others = SEPARATOR_LINE.split(text)
    definitions = dict(KNOWN_ANYWAY)
    for other in others:
        if not (named := NAME_LINE.match(other)):
            raise SchemaError(
                f"{type_name}: no 'MSG: package/Type' line behind a separator in its schema text"
            )
        try:
            definitions[_short(named[1])] = other[named.end() :]
        except ValueError:
            raise SchemaError(f"{type_name}: {named[1]!r} in its schema is not the name of a type") from None
    if named := NAME_LINE.match(first):
        first = first[named.end() :]
    return _Builder(definitions).build(type_name, first, version)


def message_type_of(type_name: str, fields: Mapping[str, FieldType]) -> type[Message]:
    """Create a message class from the types of its fields.

    Args:
        type_name: full name, such as `test_msgs/action/Fibonacci_FeedbackMessage`.
        fields: types by the names of the fields, in their order.
    """
    body = {
        "__annotations__": {python_name(name): Annotated[Any, kind] for name, kind in fields.items()},
        "__module__": __name__,
        "__doc__": "Made from the types of its fields.",
    }
    return cast(type[Message], MessageType(type_name.rpartition("/")[2], (Message,), body, name=type_name))


def _short(name: str) -> str:
    return name if name.count("/") == 1 else short_name(name)


class _Extent(NamedTuple):
    """The extent of a message or a field with everything nested in it."""

    fields: int = 1
    nesting: int = 0
    fixed_bytes: int = OBJECT_BYTES

    def times(self, count: int) -> _Extent:
        """Return the extent of a list of these; the code for its elements exists once."""
        return self._replace(fixed_bytes=OBJECT_BYTES + count * self.fixed_bytes)

    def and_field(self, other: _Extent) -> _Extent:
        """Return the extent of a message with one more field.

        Raises:
            ValueError: a limit is exceeded.
        """
        fields, fixed_bytes = self.fields + other.fields, self.fixed_bytes + other.fixed_bytes
        nesting = max(self.nesting, other.nesting)
        if fields > MAX_FIELDS:
            raise ValueError(
                f"more than {MAX_FIELDS} fields, including those of nested messages; that is the limit"
            )
        if nesting > MAX_NESTING:
            raise ValueError(f"messages nested more than {MAX_NESTING} deep; that is the limit")
        if fixed_bytes > MAX_FIXED_BYTES:
            raise ValueError(f"arrays of fixed length of {fixed_bytes} bytes; the limit is {MAX_FIXED_BYTES}")
        return _Extent(fields, nesting, fixed_bytes)


@dataclass
class _Builder:
    definitions: dict[str, str]
    """By short name."""
    made: dict[str, type[Message] | None] = field(default_factory=dict)
    """By short name; None while one is being made."""
    extents: dict[str, _Extent] = field(default_factory=dict)
    """By type name."""
    nesting: int = 0
    """The depth of the description that is being parsed."""

    def build(self, type_name: str, definition: str, version: int) -> type[Message]:
        annotations: dict[str, Any] = {}
        body: dict[str, Any] = {
            "__annotations__": annotations,
            "__module__": __name__,
            "__doc__": "Made from a schema.",
        }
        extent = _Extent()
        for line in definition.splitlines():
            if len(line) > MAX_LINE_CHARACTERS:
                raise SchemaError(
                    f"{type_name}: a line of its schema has {len(line)} characters; the limit is "
                    f"{MAX_LINE_CHARACTERS}"
                )
            if content := _content(line):
                try:
                    kind = self._declare(type_name, content, annotations, body)
                    extent = extent if kind is None else extent.and_field(self._extent(kind))
                except (
                    ValueError,
                    TypeError,
                    SyntaxError,
                    MessageError,
                    RecursionError,
                    MemoryError,
                ) as error:
                    raise SchemaError(
                        f"{type_name}: in the line {content!r:.200} of its schema: {error}"
                    ) from error
        self.extents[type_name] = extent  # checked before the class is created, which processes every field
        try:
            made = MessageType(
                type_name.rpartition("/")[2], (Message,), body, name=type_name, version=version
            )
            return cast(type[Message], made)
        except MessageError as error:
            raise SchemaError(f"{type_name}: its schema does not describe a message type: {error}") from error

    def _extent(self, kind: FieldType) -> _Extent:
        """Return the extent of a field."""
        match kind:
            case Nested():
                inner = self.extents[kind.layout.type_name]
                return _Extent(inner.fields + 1, inner.nesting + 1, inner.fixed_bytes + OBJECT_BYTES)
            case Items():
                return self._extent(kind.element).times(kind.length or 0)
            case Numbers():
                return _Extent(fixed_bytes=OBJECT_BYTES + (kind.length or 0) * kind.element.size)
            case _:
                return _Extent()

    def _declare(
        self, type_name: str, line: str, annotations: dict[str, Any], body: dict[str, Any]
    ) -> FieldType | None:
        """Process a line; return the type of its field, or None for a constant."""
        parts = LINE.fullmatch(line)
        if not parts:
            raise ValueError("expected 'type name', 'type name default' or 'type NAME=value'")
        kind, name = self._type(type_name, parts["type"]), parts["name"]
        annotation = Annotated[Any, kind]
        if not name.isidentifier():  # some digits are none in Python
            raise ValueError(f"{name!r} is not a name")
        if parts["constant"] is not None:
            if name in TAKEN_NAMES or name in annotations:  # it would replace a method, or a field
                raise ValueError(f"a constant cannot be called {name}")
            annotations[name] = ClassVar[str if isinstance(kind, Text) else annotation]
            body[name] = _value(kind, parts["constant"])
            return None
        name = python_name(name)
        if name in annotations:
            raise ValueError(f"there are two fields {name}")
        annotations[name] = annotation
        if parts["default"]:
            body[name] = _value(kind, parts["default"])
        return kind

    def _type(self, owner: str, text: str) -> FieldType:
        parts = TYPE.fullmatch(text)
        if not parts or (parts["text"] and parts["base"] != "string"):
            raise ValueError(f"{text!r} is not a type")
        element = self._element(owner, parts["base"], int(parts["text"]) if parts["text"] else None)
        if not parts["several"]:
            return element
        count = int(parts["count"]) if parts["count"] else None
        length, max_length = (None, count) if parts["bounded"] else (count, None)
        if isinstance(element, Text | Nested):
            return Items(element, length, max_length)
        assert not isinstance(element, Numbers | Items)
        return Numbers(element, length, max_length)

    def _element(self, owner: str, name: str, text_bound: int | None) -> FieldType:
        if name in PRIMITIVES:
            return PRIMITIVES[name]
        if name == "string":
            return Text(text_bound)
        if name == "wstring":
            raise ValueError("wstring is not supported")
        return nested(self._nested(owner, name))

    def _nested(self, owner: str, name: str) -> type[Message]:
        short = _short(name) if "/" in name else f"{owner.partition('/')[0]}/{name}"
        if short not in self.definitions and name == "Header":
            short = "std_msgs/Header"
        if short not in self.definitions:
            raise ValueError(f"no definition of {short}{did_you_mean(short, self.definitions)}")
        if short not in self.made:
            self.made[short] = None
            self.nesting += 1
            if self.nesting > MAX_NESTING:
                raise ValueError(f"messages nested more than {MAX_NESTING} deep; that is the limit")
            self.made[short] = self.build(short.replace("/", "/msg/"), self.definitions[short], version=1)
            self.nesting -= 1
        made = self.made[short]
        if made is None:
            raise ValueError(f"{short} contains itself")
        return made


def _content(line: str) -> str:
    """Return a line without its comment, but with the default that stands there."""
    content = COMMENT.sub(lambda found: found[1] or "", line).strip()
    default = DEFAULT_COMMENT.fullmatch(line)
    return f"{content} {default['value']}" if default else content


def _value(kind: FieldType, text: str) -> Any:
    """Return the value of a constant or a default."""
    if isinstance(kind, Text) and text[:1] not in ("'", '"'):
        return text
    if kind == PRIMITIVES["bool"] and text.lower() in ("true", "false"):
        return text.lower() == "true"
    if kind in (PRIMITIVES["float32"], PRIMITIVES["float64"]) and text.lower().lstrip("+-") in NOT_FINITE:
        return float(text)
    value = ast.literal_eval(re.sub(r"\b(true|false)\b", lambda word: word[0].title(), text))
    return bool(value) if kind == PRIMITIVES["bool"] else value
