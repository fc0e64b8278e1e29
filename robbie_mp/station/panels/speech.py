"""The speech commands of the profile, and the persons and objects that the robot knows."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import String
from robbie_mp.station.page.page import Page
from robbie_mp.station.panel import Panel
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

TOPIC = "speech_command"
MAX_HEARD = 20
"""Maximum number of given commands that the panel shows."""
MAX_COMMAND_CHARACTERS = 1000


class SpeechPanel(Panel):
    """Gives commands as if they had been spoken, and shows the given commands."""

    name = "speech"
    title = "Speech"
    icon = "record_voice_over"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self.heard: deque[str] = deque(maxlen=MAX_HEARD)
        self._messages, self._settings = station.messages, station.settings
        station.messages.hear(String, self._on_command, TOPIC)

    @classmethod
    def is_wanted(cls, station: StationContext) -> bool:
        """Whether the profile names anything."""
        settings = station.settings
        return bool(settings.speech_commands or settings.persons or settings.objects)

    def _on_command(self, command: String) -> None:
        text = f"{self._messages.envelope.sender}: {command.data[:MAX_COMMAND_CHARACTERS]}"
        self.heard = deque((*self.heard, text), MAX_HEARD)  # a new deque, because pages read the old one

    def say(self, page: Page, command: str) -> None:
        """Publish a command."""
        page.publish(String(data=command[:MAX_COMMAND_CHARACTERS]), "the command", TOPIC)

    def build(self, page: Page) -> None:
        """Build the commands, the names in the profile, and the list of given commands."""
        if page.role is Role.OPERATOR:
            with ui.row().props("id=speech-commands"):
                for command in self._settings.speech_commands:
                    button = ui.button(command, on_click=lambda command=command: self.say(page, command))
                    button.props("no-caps")
            words = [*self._settings.speech_commands, *self._settings.persons, *self._settings.objects]
            text = ui.input("something else", autocomplete=words).classes("w-96")
            text.props(f"for=speech-text maxlength={MAX_COMMAND_CHARACTERS}")

            def say() -> None:
                if said := str(text.value or "").strip():
                    self.say(page, said)
                    text.set_value("")

            text.on("keyup.enter", say)
        for title, names in (("persons", self._settings.persons), ("objects", self._settings.objects)):
            _listed(title, names)
        heard = ui.column().classes("gap-0").props("id=speech-heard")
        shown: list[str] = []

        def update() -> None:
            now = [*self.heard]
            if now != shown:
                shown[:] = now
                heard.clear()
                with heard:
                    for line in reversed(now):
                        ui.label(line)

        page.every(0.2, self.name, update)


def _listed(title: str, names: Sequence[str]) -> None:
    with ui.row().classes("items-center").props(f"id=speech-{title}"):
        ui.label(f"{title}: {'' if names else 'none in the profile'}")
        for name in names:
            ui.badge(name).props("outline")
