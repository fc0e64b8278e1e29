"""What happened: clips, recordings and snapshots, to look at or to take home, and the report of the run."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.attached.views import quantities
from robbie_mp.base.utc import time_of_day
from robbie_mp.logs.black_box.clip_folder import CLIPS, saved_clips
from robbie_mp.logs.black_box.happenings import Happening, HappeningKind, happenings_of, text_of
from robbie_mp.logs.black_box.module import CLIP_TOPIC
from robbie_mp.messages import Clip
from robbie_mp.station.panel import Panel
from robbie_mp.station.past.files import CLIP_PATH, RECORDING_PATH, REPORT_PATH, SNAPSHOT_PATH
from robbie_mp.station.past.player import PLAYER_PATH
from robbie_mp.station.past.recordings import saved_recordings
from robbie_mp.station.past.snapshots import saved_snapshots
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from collections.abc import Callable

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.page.page import Page

REFRESH_S = 1.0
SHOWN = 100
"""Maximum number of rows; `robbie clips` lists all."""
RECORDING, SNAPSHOT = "recording", "snapshot"
LOOKS: dict[str, tuple[str, str]] = {
    HappeningKind.FAILED: ("dangerous", "text-negative"),
    HappeningKind.CRASH: ("heart_broken", "text-negative"),
    HappeningKind.HANG: ("hourglass_disabled", "text-negative"),
    HappeningKind.STOP: ("front_hand", "text-negative"),
    HappeningKind.BUMPER: ("crisis_alert", "text-orange"),
    HappeningKind.VICTIM: ("personal_injury", "text-primary"),
    HappeningKind.MARK: ("bookmark", "text-primary"),
    HappeningKind.OTHER: ("speed", "text-orange"),
    RECORDING: ("album", "text-primary"),
    SNAPSHOT: ("photo_camera", "text-primary"),
}
"""Icon and colour of each kind."""
GO = f"window.location.assign(`${{window.path_prefix}}{PLAYER_PATH}/`)"


@dataclass(frozen=True)
class Row:
    """Something to take home."""

    time_s: float
    """Seconds since 1970."""
    kind: str
    """A `HappeningKind`, `recording` or `snapshot`."""
    text: str
    path: str
    """Of the file on this server."""
    bytes: int
    happening: Happening | None = None
    """What the page can play."""

    @property
    def file(self) -> str:
        """What the file is, in words."""
        return "clip" if self.happening else self.kind


class HappenedPanel(Panel):
    """Lists what black box and operators have kept of this run, the newest first."""

    name = "happened"
    title = "What happened"
    icon = "history"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._folder = station.run.output_directory
        self._player, self._recorder = station.run.player, station.run.recorder
        self._open = station.messages.newest(Clip, CLIP_TOPIC)
        self._next_s = 0.0
        self.rows: tuple[Row, ...] = ()
        """The newest ones. The tuple is replaced and never changed, because pages read it."""
        self.more = 0

    def tick(self) -> None:
        """Look what is on the disk, if a page shows it."""
        if self.is_looked_at and time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + REFRESH_S
            found = [*clips_in(self._folder), *kept_by_hand(self._folder, self._recorder.name)]
            found.sort(key=lambda row: row.time_s, reverse=True)
            self.rows = tuple(found[:SHOWN])
            self.more = len(found) - len(self.rows)

    def _being_written(self) -> str:
        """Return what happened in the clip that still grows, and what is recorded; '' if there is neither."""
        recording = ["a recording"] if self._recorder.name else []
        return "; ".join([*recording, *filter(None, [self._open_clip()])])

    def _open_clip(self) -> str:
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
        for one in self.rows:
            icon, colour = LOOKS[one.kind]
            with ui.row().classes("happened-row no-wrap").props(f"data-kind={one.kind}"):
                ui.icon(icon).classes(colour).props(f'aria-label="{one.kind}"')
                ui.label(time_of_day(one.time_s)[:8]).classes("happened-time")
                ui.label(one.text).classes("happened-text")
                if (happening := one.happening) is not None and page.role is Role.OPERATOR:
                    look = ui.button(icon="play_arrow", on_click=lambda happening=happening: play(happening))
                    look.props("flat dense round size=sm").props["aria-label"] = f"Look at: {one.text}"
                link = ui.link(quantities.size(one.bytes), one.path).props("download")
                link.props["aria-label"] = f"Download the {one.file}: {one.text}"
        if self.more:
            ui.label(f"and {self.more} more; robbie clips lists all")


def clips_in(folder: Path) -> Iterator[Row]:
    """Yield what the black box has kept in the results of a run."""
    saved = saved_clips([folder / CLIPS])
    sizes = {clip.folder.name: clip.bytes for clip in saved}
    for one in happenings_of(saved):
        yield Row(one.time_s, one.kind, one.text, f"{CLIP_PATH}{one.clip}", sizes[one.clip], one)


def kept_by_hand(folder: Path, being_made: str) -> Iterator[Row]:
    """Yield what operators have kept in the results of a run, without the recording that is being made."""
    for recording in saved_recordings(folder):
        if recording.name != being_made:
            path = f"{RECORDING_PATH}{recording.name}"
            yield Row(recording.time_s, RECORDING, "recording by hand", path, recording.bytes)
    for snapshot in saved_snapshots(folder):
        text = f"snapshot of {snapshot.camera}"
        yield Row(snapshot.time_s, SNAPSHOT, text, f"{SNAPSHOT_PATH}{snapshot.name}", snapshot.bytes)
