"""The form that sends a message, once or at a rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.base.errors import RobbieError
from robbie_mp.messages.field_types import Text
from robbie_mp.station.panels.composer import FormError, compose, form_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from logging import Logger

    from robbie_mp.messages import Message
    from robbie_mp.messages.descriptions import KnownTypes
    from robbie_mp.station.page.page import Page

MAX_FIELDS = 200
MAX_HZ = 20.0
COUNT_PERIOD_S = 0.5


class MessageForm:
    """A choice of types, and a line for each field of the chosen type.

    Sending at a rate repeats the message that the form described at the start. It ends when the page is
    closed or its connection is lost, and does not resume.

    Args:
        words: suggestions for texts.
        log: notes when sending at a rate ends.
        types: types to choose from.
        version_of: returns in which version a type is published on a topic; None: it is not.
        page: the page of the form.
    """

    def __init__(
        self,
        words: list[str],
        log: Logger,
        types: KnownTypes,
        version_of: Callable[[str, str], int | None],
        page: Page,
    ):
        self._words = words
        self._log = log
        self._types = types
        self._version_of = version_of
        self._page = page
        self._type: type[Message] | None = None
        self._inputs: dict[str, ui.input] = {}
        with ui.row().classes("items-center"):
            self._kind = ui.select(types.names(), label="type", with_input=True, clearable=True)
            self._kind.props("for=compose-type").classes("w-96").on_value_change(self._build)
            self._topic = ui.input("topic", on_change=self._build).props("for=compose-topic")
        self._fields = ui.column().classes("w-full gap-0").props("id=compose-fields")
        with ui.row().classes("items-center") as self._buttons:
            ui.button("Send once", icon="send", on_click=self._send).props("id=compose-send")
            self._rate = ui.input("times a second", value="1").classes("w-32").props("for=compose-rate")
            self._begin_button = ui.button("Send at this rate", icon="repeat", on_click=self._begin)
            self._begin_button.props("id=compose-begin")
            self._end_button = ui.button("Stop sending", icon="stop", color="deep-orange-10")
            self._end_button.on_click(lambda: self._end("by hand")).props("id=compose-end")
            self._result = ui.label("").props("id=compose-result role=status")
        self._repeated: Message | None = None
        self._count = 0
        self._timer: ui.timer | None = None
        ui.context.client.on_disconnect(lambda: self._end("the page was closed, or its connection lost"))
        self._show_repeating()
        page.every(COUNT_PERIOD_S, "messages", self._show_count)

    def _build(self) -> None:
        """Build the fields of the chosen type, in the version that the chosen topic has, if they change."""
        try:
            chosen = self._chosen_type(str(self._kind.value or ""), str(self._topic.value or ""))
            problem = ""
        except RobbieError as error:
            chosen, problem = None, str(error)
        if chosen is not None and chosen is self._type:
            return
        typed = {path: line.value for path, line in self._inputs.items()}
        self._fields.clear()
        self._inputs.clear()
        self._type = chosen
        self._result.set_text(problem)
        if chosen is not None:
            self._build_fields(chosen, typed)

    def _chosen_type(self, name: str, topic: str) -> type[Message] | None:
        """Return the class of the message to send.

        Raises:
            RobbieError: its description is unknown or invalid.
        """
        if not name:
            return None
        version = self._version_of(name, topic)
        before = self._type
        if before is not None and before.type_name == name and version in (None, before.version):
            return before
        return self._types.get(name, version)

    def _build_fields(self, chosen: type[Message], typed: Mapping[str, str]) -> None:
        """Build a line for each field, with what was typed there before."""
        with self._fields:
            for field in form_of(chosen)[:MAX_FIELDS]:
                known = self._words if isinstance(field.kind, Text) else None
                label = f"{field.path} ({field.kind})"
                before = typed.get(field.path, "")
                line = ui.input(label, placeholder=field.default, autocomplete=known, value=before)
                line.classes("w-full").props(f'dense data-field="{field.path}"')
                self._inputs[field.path] = line

    def _message(self) -> Message | None:
        """Return the message that the form describes; if it is invalid, show the errors and return None."""
        if self._type is None:
            self._result.set_text("choose a type first")
            return None
        texts = {path: str(line.value or "") for path, line in self._inputs.items()}
        problems: dict[str, str] = {}
        message = None
        try:
            message = compose(self._type, texts)
        except FormError as error:
            problems = error.problems
            self._result.set_text("not sent: see the fields in red")
        for path, line in self._inputs.items():
            line.error = problems.get(path)
        return message

    def _send(self) -> None:
        if (message := self._message()) is not None and self._publish(message):
            self._result.set_text(f"sent a {message.type_name}")

    def _publish(self, message: Message) -> bool:
        try:
            is_sent = self._page.publish(message, "the message", str(self._topic.value or ""))
        except RobbieError as error:  # for example, the name of the topic is too long
            self._topic.error = str(error)
            self._result.set_text("not sent: see the fields in red")
            return False
        self._topic.error = None
        if not is_sent:
            self._result.set_text("not sent")
        return is_sent

    def _begin(self) -> None:
        """Send the message repeatedly, if form and rate are valid."""
        self._rate.error = None
        try:
            rate_hz = float(self._rate.value or "")
        except ValueError:
            rate_hz = 0.0
        if not 0 < rate_hz <= MAX_HZ:
            self._rate.error = f"expected a number above 0, at most {MAX_HZ:g}"
            return
        if (message := self._message()) is None:
            return
        self._repeated, self._count = message, 0
        with self._buttons:
            self._timer = ui.timer(1 / rate_hz, self._again)
        self._show_repeating()

    def _again(self) -> None:
        if self._repeated is None or not self._publish(self._repeated):
            self._end("it could not be sent")
            return
        self._count += 1

    def _show_count(self) -> None:
        if self._repeated is not None:
            self._result.set_text(f"sent {self._count} times")

    def _end(self, why: str) -> None:
        if self._repeated is None:
            return
        self._log.info("no more %s are sent: %s", self._repeated.type_name, why)
        self._repeated = None
        if self._timer is not None:
            self._timer.cancel()
        self._show_repeating()

    def _show_repeating(self) -> None:
        self._begin_button.set_visibility(self._repeated is None)
        self._end_button.set_visibility(self._repeated is not None)
