"""A form for any message type: a line of text for each field, checked one by one."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robbie_mp.attached.views.message_text import FieldPath, to_yaml
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.problem import ProfileError
from robbie_mp.base.yaml_reader import read_text
from robbie_mp.messages import FieldError, Message, from_dict
from robbie_mp.messages.field_types import FieldType, Nested, Text
from robbie_mp.messages.message import fields_of


class FormError(RobbieError, ValueError):
    """Fields of a form have invalid texts.

    Attributes:
        problems: the problem of each invalid field, by its path.
    """

    def __init__(self, problems: Mapping[str, str]):
        super().__init__("; ".join(f"{path}: {problem}" for path, problem in problems.items()))
        self.problems = dict(problems)


@dataclass(frozen=True)
class FormField:
    """One field that takes a text."""

    path: str
    """Path of the field, such as pose.position.x."""
    kind: FieldType
    default: str
    """The value if its text is empty."""


def form_of(message_type: type[Message]) -> list[FormField]:
    """Return the fields of a form for a type, with each field of nested messages."""
    message = message_type()
    found = []
    for path, kind in _leaves(message_type, ""):
        default = FieldPath(message_type, path).value(message, full=False)
        found.append(FormField(path, kind, default if isinstance(kind, Text) else to_yaml(default)))
    return found


def _leaves(message_type: type[Message], prefix: str) -> Iterator[tuple[str, FieldType]]:
    for field in fields_of(message_type):
        if isinstance(field.type, Nested):
            yield from _leaves(field.type.message, f"{prefix}{field.name}.")
        else:
            yield prefix + field.name, field.type


def compose(message_type: type[Message], texts: Mapping[str, str]) -> Message:
    """Return the message that a form describes.

    Args:
        message_type: its type.
        texts: texts by the paths of fields. Strings are taken as they are, everything else is YAML; an empty
            text means the default.

    Raises:
        FormError: fields are invalid; the error says which and why.
    """
    plain: dict[str, Any] = {}
    problems: dict[str, str] = {}
    for path, text in texts.items():
        if not text.strip():
            continue
        try:
            value = _value_of(text, FieldPath(message_type, path).kind)
            from_dict(
                message_type, _nest({}, path, value)
            )  # one field at a time, so that an error belongs to its field
            _nest(plain, path, value)
        except (ProfileError, FieldError) as error:
            problems[path] = str(error)
    if problems:
        raise FormError(problems)
    return from_dict(message_type, plain)


def _value_of(text: str, kind: FieldType) -> Any:
    return text if isinstance(kind, Text) else read_text(text, "YAML").plain()


def _nest(plain: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    *parents, name = path.split(".")
    inner = plain
    for parent in parents:
        inner = inner.setdefault(parent, {})
    inner[name] = value
    return plain
