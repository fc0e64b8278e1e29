"""The bar of a page that plays a log or a clip: it says that no live robot is shown."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import PlaybackState

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.latest import MessageSource

BACK = "() => window.location.assign(`${window.stop_prefix}/`)"
TITLE_PERIOD_S = 0.5


class PastBanner:
    """Stands above the tiles, in place of who controls the robot.

    Args:
        title: what the clip shows.
    """

    def __init__(self, title: str):
        self._title = title

    def build(self, page: Page) -> None:
        """Build the bar."""
        with ui.row().classes("past-banner no-wrap").props("id=past role=status"):
            ui.icon("history")
            with ui.column().classes("gap-0 past-text"):
                ui.label("THE PAST: you do not see the robot of now")
                ui.label(self._title).props("id=past-title")
            ui.space()
            ui.label("The emergency stop acts at once on the robot of now.").classes("past-note")
            back = ui.button("Back to live", icon="sensors").props("id=back-to-live no-caps unelevated")
            back.on("click", js_handler=BACK)
        page.add_key("l", "Back to live", go_back)


class LogBanner:
    """Stands above the tiles of a page beside a log, in place of who controls the robot.

    Args:
        messages: source of the playback's state.
    """

    def __init__(self, messages: MessageSource):
        self._state = messages.newest(PlaybackState)

    def build(self, page: Page) -> None:
        """Build the bar."""
        with ui.row().classes("past-banner no-wrap").props("id=past role=status"):
            ui.icon("history")
            with ui.column().classes("gap-0 past-text"):
                ui.label("A LOG: you see no live robot")
                title = ui.label("").props("id=past-title")
            ui.space()
            ui.label("Nothing here moves a robot.").classes("past-note")

        def update() -> None:
            if self._state.message is not None:
                title.set_text(Path(self._state.message.file).name)

        page.always(TITLE_PERIOD_S, update)


def go_back() -> None:
    """Let the browser open the live page."""
    ui.run_javascript(f"({BACK})()")
