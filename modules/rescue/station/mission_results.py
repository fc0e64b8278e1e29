"""The results of a mission that has ended, and its report. The page keeps them when the run ends, too."""

from __future__ import annotations

import math
import os
import re
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import app, ui
from nicegui.element import Element
from starlette.exceptions import HTTPException
from starlette.responses import Response

from robbie_mp.messages import TimeJump
from robbie_mp.station.page.state_item import clock_text
from robbie_robots.modules.rescue.messages import MissionResult, MissionStatus

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.latest import MessageSource

STYLE = Path(__file__).parent / "mission_results.css"
DONE = "DONE"
ENDS = {DONE: "The mission is done", "FAILED": "The mission has failed", "ABORTED": "The mission was aborted"}
"""States of a mission that has ended, each with the title of its results."""
ADDRESS = "/results/{name}"
MAX_FILE_BYTES = 1 << 25
Rows = list[tuple[str, str]]


class ResultsCard(Element, component="mission_results.js"):
    """Shows results until you close them."""

    def __init__(self) -> None:
        super().__init__()
        self._props.update(title="", rows=[], files=[])

    def show(self, title: str, rows: Rows, files: list[str]) -> None:
        """Show other results; none hide the card."""
        now = {"title": title, "rows": rows, "files": files}
        if any(self._props[name] != value for name, value in now.items()):
            self._props.update(now)
            self.update()


class MissionResults:
    """Keeps the results of the newest mission, until another one is under way.

    Args:
        messages: source of the messages.
        folder: where the report's files are, if the mission runs on this machine.
    """

    def __init__(self, messages: MessageSource, folder: Path):
        self._folder = folder
        self.title, self.rows, self.files = "", Rows(), list[str]()
        app.add_api_route(ADDRESS, self._answer, include_in_schema=False, response_class=Response)
        messages.hear(MissionResult, self._on_result)
        messages.hear(MissionStatus, self._on_status)
        messages.hear(TimeJump, lambda _jump: self._forget())

    def build(self, page: Page) -> None:
        """Add the card to a page."""
        ui.add_css(STYLE)
        card = ResultsCard()
        page.always(0.2, lambda: card.show(self.title, self.rows, self.files))

    def _on_result(self, result: MissionResult) -> None:
        self.title, self.rows = ENDS.get(result.state, "The mission has ended"), rows_of(result)
        self.files = [name for name in result.files if self._content(name) is not None]

    def _on_status(self, status: MissionStatus) -> None:
        if status.state not in ENDS:
            self._forget()

    def _forget(self) -> None:
        self.rows, self.files = [], []

    def _answer(self, name: str) -> Response:
        """Answer the request for a file of the report, and for no other one."""
        content = self._content(name) if name in self.files else None
        if content is None:
            raise HTTPException(404)
        headers = {
            "Content-Disposition": f'attachment; filename="{name}"',
            "X-Content-Type-Options": "nosniff",
        }
        return Response(content, media_type="application/octet-stream", headers=headers)

    def _content(self, name: str) -> bytes | None:
        """Return what a file of the report holds; None if it is not there, or no plain file."""
        if not re.fullmatch(r"[\w.-]{1,100}", name, re.ASCII):
            return None
        try:
            descriptor = os.open(self._folder / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError:
            return None
        with open(descriptor, "rb") as file:
            return file.read(MAX_FILE_BYTES) if stat.S_ISREG(os.fstat(descriptor).st_mode) else None


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
