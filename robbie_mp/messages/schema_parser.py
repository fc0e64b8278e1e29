"""Message types from ros2msg texts, for logs of types that this program does not declare.

Source of the grammar: https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, cast

from robbie_mp.messages.declaration import python_name
from robbie_mp.messages.errors import MessageError, SchemaError
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Text, short_name
from robbie_mp.messages.message import Message, MessageType, nested
from robbie_mp.messages.primitives import PRIMITIVES
from robbie_mp.suggest import did_you_mean

SEPARATOR_LINE = re.compile(r"^={3,}\s*$", re.MULTILINE)
NAME_LINE = re.compile(r"\s*MSG:\s*(\S+)\s*\n")
COMMENT = re.compile(r"""("(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')|\#.*""")
LINE = re.compile(r"(?P<type>\S+)\s+(?P<name>[A-Za-z]\w*)(?:\s*=\s*(?P<constant>.*)|\s+(?P<default>.*))?")
TYPE = re.compile(r"(?P<base>[\w/]+)(?:<=(?P<text>\d+))?(?P<several>\[(?P<bounded><=)?(?P<count>\d*)\])?")
KNOWN_ANYWAY = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
"""What some writers leave out, because it is built into theirs."""


def message_type_from_schema(type_name: str, text: str, version: int = 1) -> type[Message]:
    """Make a message class from a ros2msg text.

    Args:
        type_name: as in `sensor_msgs/msg/LaserScan`.
        text: its definition and those of the types in it, as `schema_text` returns them.
        version: what the class says its version is.

    Raises:
        SchemaError: the text is not understood, incomplete, or needs what CDR decoders here lack (wstring).
    """
    first, *others = SEPARATOR_LINE.split(text)
    definitions = dict(KNOWN_ANYWAY)
    for other in others:
        if not (named := NAME_LINE.match(other)):
            raise SchemaError(
                f"{type_name}: no 'MSG: package/Type' line behind a separator in its schema text"
            )
        definitions[_short(named[1])] = other[named.end() :]
    return _Builder(definitions).build(type_name, NAME_LINE.sub("", first, count=1), version)


def _short(name: str) -> str:
    return name if name.count("/") == 1 else short_name(name)


@dataclass
class _Builder:
    definitions: dict[str, str]
    """By short name."""
    made: dict[str, type[Message] | None] = field(default_factory=dict)
    """By short name; None while one is being made."""

    def build(self, type_name: str, definition: str, version: int) -> type[Message]:
        annotations: dict[str, Any] = {}
        body: dict[str, Any] = {
            "__annotations__": annotations,
            "__module__": __name__,
            "__doc__": "Made from a schema.",
        }
        for line in definition.splitlines():
            if content := COMMENT.sub(lambda found: found[1] or "", line).strip():
                try:
                    self._declare(type_name, content, annotations, body)
                except (ValueError, SyntaxError, MessageError) as error:
                    raise SchemaError(
                        f"{type_name}: in the line {content!r} of its schema: {error}"
                    ) from error
        try:
            made = MessageType(
                type_name.rpartition("/")[2], (Message,), body, name=type_name, version=version
            )
            return cast(type[Message], made)
        except MessageError as error:
            raise SchemaError(f"{type_name}: its schema makes no message type: {error}") from error

    def _declare(self, type_name: str, line: str, annotations: dict[str, Any], body: dict[str, Any]) -> None:
        parts = LINE.fullmatch(line)
        if not parts:
            raise ValueError("expected 'type name', 'type name default' or 'type NAME=value'")
        kind, name = self._type(type_name, parts["type"]), parts["name"]
        annotation = Annotated[Any, kind]
        if parts["constant"] is not None:
            annotations[name] = ClassVar[str if isinstance(kind, Text) else annotation]
            body[name] = _value(kind, parts["constant"])
            return
        name = python_name(name)
        if name in annotations:
            raise ValueError(f"there are two fields {name}")
        annotations[name] = annotation
        if parts["default"]:
            body[name] = _value(kind, parts["default"])

    def _type(self, owner: str, text: str) -> FieldType:
        parts = TYPE.fullmatch(text)
        if not parts or (parts["text"] and parts["base"] != "string"):
            raise ValueError(f"{text!r} is no type")
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
            self.made[short] = self.build(short.replace("/", "/msg/"), self.definitions[short], version=1)
        made = self.made[short]
        if made is None:
            raise ValueError(f"{short} contains itself")
        return made


def _value(kind: FieldType, text: str) -> Any:
    """Return the value of a constant or a default."""
    if isinstance(kind, Text) and text[:1] not in ("'", '"'):
        return text
    if kind == PRIMITIVES["bool"] and text.lower() in ("true", "false"):
        return text.lower() == "true"
    value = ast.literal_eval(re.sub(r"\b(true|false)\b", lambda word: word[0].title(), text))
    return bool(value) if kind == PRIMITIVES["bool"] else value
