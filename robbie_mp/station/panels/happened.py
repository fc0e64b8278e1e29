"""What happened: the clips of the black box, to look at or to take home, and the report of the run."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.attached.views import quantities
from robbie_mp.base.utc import time_of_day
from robbie_mp.logs.black_box.clip_folder import CLIPS, saved_clips
from robbie_mp.logs.black_box.happenings import Happening, HappeningKind, happenings_of, text_of
from robbie_mp.logs.black_box.module import CLIP_TOPIC
from robbie_mp.messages import Clip
from robbie_mp.station.panel import Panel
from robbie_mp.station.past.files import CLIP_PATH, REPORT_PATH
from robbie_mp.station.past.player import PLAYER_PATH
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from collections.abc import Callable

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.page.page import Page

REFRESH_S = 1.0
SHOWN = 100
"""Maximum number of rows; `robbie clips` lists all."""
LOOKS = {
    HappeningKind.FAILED: ("dangerous", "text-negative"),
    HappeningKind.CRASH: ("heart_broken", "text-negative"),
    HappeningKind.HANG: ("hourglass_disabled", "text-negative"),
    HappeningKind.STOP: ("front_hand", "text-negative"),
    HappeningKind.BUMPER: ("crisis_alert", "text-orange"),
    HappeningKind.VICTIM: ("personal_injury", "text-primary"),
    HappeningKind.MARK: ("bookmark", "text-primary"),
    HappeningKind.OTHER: ("speed", "text-orange"),
}
"""Icon and colour of each kind."""
GO = f"window.location.assign(`${{window.path_prefix}}{PLAYER_PATH}/`)"
Row = tuple[Happening, int]
"""What happened, and the size of its clip in bytes."""


class HappenedPanel(Panel):
    """Lists what the black box has kept of this run, the newest first."""

    name = "happened"
    title = "What happened"
    icon = "history"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._folder = station.run.output_directory / CLIPS
        self._player = station.run.player
        self._open = station.messages.newest(Clip, CLIP_TOPIC)
        self._next_s = 0.0
        self.rows: tuple[Row, ...] = ()
        """The newest ones. The tuple is replaced and never changed, because pages read it."""
        self.more = 0

    def tick(self) -> None:
        """Look what is on the disk, if a page shows it."""
        if self.is_looked_at and time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + REFRESH_S
            saved = saved_clips([self._folder])
            sizes = {clip.folder.name: clip.bytes for clip in saved}
            found = happenings_of(saved)[::-1]
            self.rows = tuple((one, sizes[one.clip]) for one in found[:SHOWN])
            self.more = len(found) - len(self.rows)

    def _being_written(self) -> str:
        """Return what happened in the clip that still grows; '' if there is none."""
        clip = self._open.message
        if clip is None or clip.state != Clip.OPEN or not clip.triggers:
            return ""
        return "; ".join(text_of(trigger) for trigger in clip.triggers[:3])

    def open(self, page: Page, happening: Happening) -> None:
        """Play a clip on the page."""
        if page.may("the playback of a clip"):
            title = f"{happening.text}, {time_of_day(happening.time_s)}"
            thread = threading.Thread(
                target=self._player.open, args=(happening.clip, title), name="opens a clip", daemon=True
            )
            thread.start()

    def build(self, page: Page) -> None:
        """Build the link to the report and the list."""
        with ui.row().classes("w-full items-center no-wrap"):
            report = ui.link("Report of this run", REPORT_PATH).props("id=report download")
            report.props["title"] = "One HTML file, which needs no network: map, findings, failures, counters"
            ui.space()
            note = ui.label("").props("id=happened-note role=status")
        rows = ui.column().classes("w-full gap-0 happened").props("id=happened-list tabindex=0")
        shown: list[object] = [None]
        wanted = [""]

        def play(happening: Happening) -> None:
            wanted[0] = happening.clip
            note.set_text(f"opening {happening.text} …")
            self.open(page, happening)

        def update() -> None:
            player = self._player
            if wanted[0] and player.clip == wanted[0] and player.address is not None:
                wanted[0] = ""
                ui.run_javascript(GO)
            elif wanted[0] and player.error and not player.clip:
                wanted[0] = ""
                note.set_text(f"it cannot be played: {player.error}")
            now = (self.rows, self._being_written())
            if now != shown[0]:
                shown[0] = now
                rows.clear()
                with rows:
                    self._build_rows(page, play)

        page.every(0.3, self.name, update)

    def _build_rows(self, page: Page, play: Callable[[Happening], None]) -> None:
        if being_written := self._being_written():
            with ui.row().classes("happened-row is-new"):
                ui.icon("fiber_manual_record").classes("text-negative")
                ui.label(f"being written: {being_written}")
        if not self.rows:
            ui.label("Nothing yet. Press M to mark a moment: the seconds around it are kept.")
        for one, size in self.rows:
            icon, colour = LOOKS[one.kind]
            with ui.row().classes("happened-row no-wrap").props(f"data-kind={one.kind}"):
                ui.icon(icon).classes(colour).props(f'aria-label="{one.kind}"')
                ui.label(time_of_day(one.time_s)[:8]).classes("happened-time")
                ui.label(one.text).classes("happened-text")
                if page.role is Role.OPERATOR:
                    look = ui.button(icon="play_arrow", on_click=lambda one=one: play(one))
                    look.props("flat dense round size=sm").props["aria-label"] = f"Look at: {one.text}"
                link = ui.link(quantities.size(size), f"{CLIP_PATH}{one.clip}").props("download")
                link.props["aria-label"] = f"Download the clip of: {one.text}"
        if self.more:
            ui.label(f"and {self.more} more; robbie clips lists all")
