"""The results of a mission that has ended. The page keeps them when the robot's run ends, too."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.element import Element

from robbie_mp.messages import TimeJump
from robbie_mp.station.page.state_item import clock_text
from robbie_robots.modules.rescue.messages import MissionResult, MissionStatus

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.latest import MessageSource

STYLE = Path(__file__).parent / "mission_results.css"
DONE = "DONE"
Rows = list[tuple[str, str]]


class ResultsCard(Element, component="mission_results.js"):
    """Shows results until you close them."""

    def __init__(self) -> None:
        super().__init__()
        self._props["rows"] = []

    def show(self, rows: Rows) -> None:
        """Show other results; none hide the card."""
        if self._props["rows"] != rows:
            self._props["rows"] = rows
            self.update()


class MissionResults:
    """Keeps the results of the newest mission, until another one is under way.

    Args:
        messages: source of the messages.
    """

    def __init__(self, messages: MessageSource):
        self.rows: Rows = []
        messages.hear(MissionResult, self._on_result)
        messages.hear(MissionStatus, self._on_status)
        messages.hear(TimeJump, lambda _jump: self._forget())

    def build(self, page: Page) -> None:
        """Add the card to a page."""
        ui.add_css(STYLE)
        card = ResultsCard()
        page.always(0.2, lambda: card.show(self.rows))

    def _on_result(self, result: MissionResult) -> None:
        self.rows = rows_of(result)

    def _on_status(self, status: MissionStatus) -> None:
        if status.state != DONE:
            self._forget()

    def _forget(self) -> None:
        self.rows = []


def rows_of(result: MissionResult) -> Rows:
    """Return the results as names and texts."""
    seen = f", {result.unconfirmed} more seen" if result.unconfirmed else ""
    limit = f" of {clock_text(result.limit_s)}" if math.isfinite(result.limit_s) else ""
    searched = f", {result.searched:.0%} of its walls searched" if math.isfinite(result.searched) else ""
    rows = [
        ("End", result.reason),
        ("Victims", f"{result.confirmed} confirmed{seen}"),
        ("Time", f"{clock_text(result.used_s)}{limit}"),
        ("Map", f"{result.mapped_m2:.1f} m²{searched}"),
        ("Way", f"{result.travelled_m:.1f} m"),
        (
            "Collisions",
            "not known, no bumper has reported" if result.collisions < 0 else f"{result.collisions}",
        ),
    ]
    if math.isfinite(result.battery):
        rows.append(("Battery", f"{result.battery:.0%} left"))
    return rows + [("Note", note) for note in result.notes]
