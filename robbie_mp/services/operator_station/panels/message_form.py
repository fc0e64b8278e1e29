"""The form that sends a message once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.errors import RobbieError
from robbie_mp.services.operator_station.composer import FormError, compose, form_of

if TYPE_CHECKING:
    from robbie_mp.messages import Message
    from robbie_mp.messages.descriptions import KnownTypes
    from robbie_mp.services.operator_station.station import OperatorStation

MOST_FIELDS = 200


class MessageForm:
    """A choice of types, and a line for each field of the one that is chosen.

    Args:
        station: who publishes.
        types: to choose from.
    """

    def __init__(self, station: OperatorStation, types: KnownTypes):
        self._station = station
        self._types = types
        self._type: type[Message] | None = None
        self._inputs: dict[str, ui.input] = {}
        with ui.row().classes("items-center"):
            kind = ui.select(types.names(), label="type", with_input=True, clearable=True)
            kind.props("for=compose-type").classes("w-96").on_value_change(
                lambda event: self._build(event.value)
            )
            self._topic = ui.input("topic").props("for=compose-topic")
        self._fields = ui.column().classes("w-full gap-0").props("id=compose-fields")
        with ui.row().classes("items-center"):
            ui.button("Send once", icon="send", on_click=self._send).props("id=compose-send")
            self._result = ui.label("").props("id=compose-result role=status")

    def _build(self, name: str | None) -> None:
        self._fields.clear()
        self._inputs.clear()
        self._type = None
        self._result.set_text("")
        if not name:
            return
        try:
            self._type = self._types.get(name)
        except RobbieError as error:
            self._result.set_text(str(error))
            return
        with self._fields:
            for field in form_of(self._type)[:MOST_FIELDS]:
                line = ui.input(f"{field.path} ({field.kind})", placeholder=field.default)
                line.classes("w-full").props(f'dense data-field="{field.path}"')
                self._inputs[field.path] = line

    def _send(self) -> None:
        if self._type is None:
            self._result.set_text("choose a type first")
            return
        texts = {path: str(line.value or "") for path, line in self._inputs.items()}
        problems: dict[str, str] = {}
        result = "not sent: see the fields in red"
        try:
            message = compose(self._type, texts)
            sent = self._station.publish(message, topic=str(self._topic.value or ""))
            result = f"sent a {self._type.type_name}" if sent else "not sent: the robot's memory is full"
        except FormError as error:
            problems = error.problems
        except RobbieError as error:  # such as a topic whose name is too long
            result = f"not sent: {error}"
        for path, line in self._inputs.items():
            line.error = problems.get(path)
        self._result.set_text(result)
