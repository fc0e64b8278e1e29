"""What makes the black box write a clip: a field of a message against a limit."""

import operator
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from robbie_mp.attached.views.message_text import FieldPath, NoSuchField
from robbie_mp.attached.views.series import splits
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.yaml_reader import read_text
from robbie_mp.logs.capture.selection import TypeAndTopic, type_pattern
from robbie_mp.messages import Message, stock_registry

ALWAYS = ("EmergencyStop.engaged == true", "Bumper.pressed != []")
"""Triggers of every robot."""
_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}
_FORM = re.compile(rf"\s*(\S+\.\S+?)\s*({'|'.join(_COMPARISONS)})\s*(\S.*?)\s*")


class TriggerError(RobbieError, ValueError):
    """A trigger is not written as one.

    Example scenarios:
      - it has no comparison, or compares a text by <
      - its message type has no such field
    """


class FieldTrigger:
    """A comparison such as `battery.percentage < 0.1`: a topic or type with a field, and a value in YAML.

    Args:
        text: the comparison.

    Raises:
        TriggerError: it is none, or names a stock type that has no such field.
    """

    def __init__(self, text: str):
        form = _FORM.fullmatch(text)
        if form is None:
            raise TriggerError(
                f"{text!r} is no trigger; write TOPIC.FIELD or TYPE.FIELD, one of {', '.join(_COMPARISONS)}, "
                "and a value, as in battery.percentage < 0.1"
            )
        self.text = text
        self._name = form[1]
        self._compare = _COMPARISONS[form[2]]
        self._value = read_text(form[3], "trigger").plain()
        if form[2] not in ("==", "!=") and not _is_number(self._value):
            raise TriggerError(f"{text!r}: {form[2]} needs a number, not {self._value!r}")
        for field in splits(self._name):
            for known in stock_registry():
                if TypeAndTopic(type_pattern(field.messages), "*").matches(known.type_name, ""):
                    self._path(known, field.path)

    def _path(self, message_type: type[Message], path: str) -> FieldPath:
        try:
            return FieldPath(message_type, path)
        except NoSuchField as error:
            raise TriggerError(f"{self.text!r}: {error}") from error

    def field_of(self, type_name: str, topic: str) -> str:
        """Return the field of the messages of a channel that the trigger is about; '' if of none."""
        for field in splits(self._name):
            is_type = TypeAndTopic(type_pattern(field.messages), "*").matches(type_name, topic)
            if is_type or (topic and field.messages == topic):
                return field.path
        return ""

    def comparison(self, message_type: type[Message], field: str) -> Callable[[Message], bool]:
        """Return what compares a field of messages.

        Raises:
            TriggerError: they have no such field.
        """
        path = self._path(message_type, field)
        return lambda message: self._holds(path.value(message))

    def _holds(self, value: Any) -> bool:
        try:
            return bool(self._compare(value, self._value))
        except TypeError:
            return False  # an element that is not there, or a text


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


class ChannelTriggers:
    """The triggers that are about one channel; each fires when its comparison becomes true.

    Args:
        decode: makes a message of its encoding.
        holds: what compares it, by the text of the trigger.
    """

    def __init__(self, decode: Callable[[memoryview], Message], holds: dict[str, Callable[[Message], bool]]):
        self._decode = decode
        self._holds = holds
        self._held: set[str] = set()

    def fired(self, data: memoryview) -> Iterator[str]:
        """Yield the triggers that a message fires.

        Raises:
            DecodeError: its bytes do not encode its type.
        """
        message = self._decode(data)
        now = {text for text, holds in self._holds.items() if holds(message)}
        before, self._held = self._held, now
        yield from (text for text in self._holds if text in now - before)


def triggers_of(texts: Iterable[str]) -> list[FieldTrigger]:
    """Return the triggers of every robot, and those of a profile.

    Raises:
        TriggerError: as for `FieldTrigger`.
    """
    return [FieldTrigger(text) for text in dict.fromkeys((*ALWAYS, *texts))]
