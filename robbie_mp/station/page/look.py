"""The look of a page: dark, or light for a screen in the sun. Each browser keeps its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page

COOKIE = "robbie-look"
DARK, LIGHT = "dark", "light"
KEEP = "document.cookie = `{cookie}={look}; path=${{window.path_prefix}}/; max-age=31536000; samesite=strict`"
"""The browser keeps the cookie for a year, for this host and any port."""


class LookSwitch:
    """Turns one page from dark to light and back.

    Args:
        kept: the look that the browser has kept; the page is dark for any other text than `light`.
    """

    def __init__(self, kept: str):
        self._mode = ui.dark_mode(kept != LIGHT)

    def build(self, page: Page) -> None:
        """Build the button, and add the key."""
        self._button = ui.button(on_click=self.turn).props("flat dense color=white id=look")
        page.add_key("b", "Bright or dark look", self.turn)
        self._show()

    def turn(self) -> None:
        """Change the look, and let the browser keep it."""
        self._mode.value = not self._mode.value
        ui.run_javascript(KEEP.format(cookie=COOKIE, look=DARK if self._mode.value else LIGHT))
        self._show()

    def _show(self) -> None:
        other = LIGHT if self._mode.value else DARK
        self._button.set_icon(f"{other}_mode")
        self._button.props["title"] = self._button.props["aria-label"] = f"{other.capitalize()} look"
