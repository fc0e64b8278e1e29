"""Marks a moment, so that you can find it in the log and on the playback's bar."""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import Mark
from robbie_mp.station.context import header_of_now
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from logging import Logger

    from robbie_mp.module.clock import Clock
    from robbie_mp.station.page.page import Page


GAMEPAD_BACK = "gamepad 8"


class MomentMarker:
    """A button at the top of the page. It marks at once, because typing a text would take too long."""

    def __init__(self, clock: Clock, log: Logger):
        self._clock = clock
        self._log = log
        self._numbers = count(1)

    def build(self, page: Page) -> None:
        """Build the button. Observers have none."""
        if page.role is not Role.OPERATOR:
            return

        def mark() -> None:
            text = f"mark {next(self._numbers)}"
            message = Mark(header=header_of_now(self._clock), text=text)
            if page.publish(message, text):
                self._log.info("%s, by hand", text)
                ui.notify(text)

        page.add_key("m", "Mark this moment", mark)
        page.add_key(GAMEPAD_BACK, "Mark this moment", mark)
        button = ui.button(icon="bookmark_add", on_click=mark).props("flat dense color=white id=mark")
        button.props('aria-label="Mark this moment" title="Mark this moment"')
