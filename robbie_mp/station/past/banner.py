"""The bar of a page that plays a clip: it says that all of it is the past, and leads back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page

BACK = "() => window.location.assign(`${window.stop_prefix}/`)"


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


def go_back() -> None:
    """Let the browser open the live page."""
    ui.run_javascript(f"({BACK})()")
