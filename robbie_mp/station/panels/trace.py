"""Shows the log of all processes while it grows, and the crash reports."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.base.utc import time_of_day
from robbie_mp.messages import PlaybackState
from robbie_mp.run.plan import CORE
from robbie_mp.run.supervisor.output import SUPERVISOR
from robbie_mp.run.trace.crash import CrashReport, report_files
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind, read_recorded
from robbie_mp.run.trace.reader import TraceFollower, crash_reports, module_names, trace_folder
from robbie_mp.station.page.page import Page
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.supervisor_orders import ModuleOrder
from robbie_mp.station.past.log_trace import LogTrace
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from pathlib import Path

    from robbie_mp.station.context import StationContext

REFRESH_S = 0.5
KEPT = 5000
"""Number of entries that are searched. `robbie log` searches all."""
SHOWN = 200
"""Maximum number of lines on a page."""
MAX_REPORTS = 20
COLOURS = {
    Kind.ERROR: "text-red-4 font-bold",
    Kind.WARNING: "text-orange-4",
    Kind.INFO: "",
    Kind.SYSTEM: "text-grey-6",
}
LOG, RUN = "log", "run"
ALL = "all"
SOURCES = {LOG: "The log", RUN: "This run"}
SHOWN_AT_FIRST = [Kind.ERROR, Kind.WARNING, Kind.INFO]


class TracePanel(Panel):
    """Shows the trace with a filter, and the crash reports."""

    name = "trace"
    title = "Trace"
    icon = "article"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._run_folder, self._output = station.run.known.folder, station.run.output_directory
        self._follower = TraceFollower(self._output)
        self.entries: deque[Entry] = deque(maxlen=KEPT)
        self.modules: list[str] = []
        self.reports: list[CrashReport] = []
        self._report_files: list[Path] = []
        self._next_s = 0.0
        self._playback = station.messages.newest(PlaybackState)
        self._log = LogTrace()

    def tick(self) -> None:
        """Read new entries for all pages, if any is open."""
        if not self._pages or time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + REFRESH_S
        if new := self._follower.read_new():
            # A new deque, because pages read the old one meanwhile.
            self.entries = deque((*self.entries, *new), KEPT)
            self.modules = module_names(self._output)
        if self._playback.message is not None:
            self._log.read(self._playback.message.file)
        files = report_files(trace_folder(self._output), None)
        if files != self._report_files:
            self._report_files = files
            self.reports = crash_reports(self._output, newest=MAX_REPORTS)

    def build(self, page: Page) -> None:
        """Build filter, lines and reports."""
        with ui.row().classes("items-center"):
            kinds = ui.select([str(kind) for kind in Kind], multiple=True, label="kinds")
            kinds.set_value([str(kind) for kind in SHOWN_AT_FIRST])
            kinds.props("id=trace-kinds dense").classes("w-40")
            module = ui.select({"": ALL}, label="module", value="").props("id=trace-module dense")
            module.classes("w-32")
            words = ui.input("text").props("for=trace-text clearable dense").classes("w-28")
            ui.space()
            of_log = ui.toggle(SOURCES, value=LOG if page.plays_log else RUN).props("id=trace-of")
            of_log.set_visibility(page.plays_log)
            recorded = RecordedKinds(self._run_folder, page)
        log = ui.log(max_lines=SHOWN).classes("w-full fills").props("id=trace-log tabindex=0")
        reports = ui.column().classes("w-full").props("id=trace-crashes")
        shown = ShownEntries()

        def update() -> None:
            is_log = of_log.value == LOG
            source = self._log if is_log else self
            entries = self._entries_of_log() if is_log else self.entries
            offered = {"": ALL, **{name: name for name in source.modules}}
            if module.options != offered:
                module.set_options(offered, value=module.value if module.value in offered else "")
            recorded.update(module.value or "", is_shown=not is_log)
            wanted = Filter(kinds.value or [], module.value or "", words.value or "", is_log=is_log)
            last = entries[-1].number if entries else 0
            if wanted != shown.filter or last < shown.number:  # the log has gone back
                shown.filter, shown.number = wanted, 0
                log.clear()
            for entry in newest(entries, wanted, shown.number):
                log.push(line_of(entry), classes=COLOURS[entry.kind])
            shown.number = last
            if shown.reports is not source.reports:
                shown.reports = source.reports
                reports.clear()
                with reports:
                    build_reports(source.reports)

        page.every(REFRESH_S, self.name, update)

    def _entries_of_log(self) -> Sequence[Entry]:
        """Return what the log's run had said up to the moment that is shown."""
        state = self._playback.message
        return () if state is None else self._log.until(state.position.nanoseconds / 1e9, KEPT)


class RecordedKinds:
    """Shows the kinds that the trace records of the chosen module. Operators can change them.

    Args:
        run_folder: folder of the run.
        page: the page. Observers cannot change anything.
    """

    def __init__(self, run_folder: Path, page: Page):
        self._run_folder = run_folder
        self._page = page
        self._module = ""
        self._order: ModuleOrder | None = None
        self._shown: list[str] = []
        self._kinds = ui.select([str(kind) for kind in Kind], multiple=True, label="recorded of all")
        self._kinds.classes("w-40").props("id=trace-recorded dense")
        self._kinds.on_value_change(lambda event: self._record(event.value or []))
        self._kinds.set_enabled(page.role is Role.OPERATOR)

    def _record(self, kinds: list[str]) -> None:
        if kinds != self._shown and self._page.may("a choice of what is recorded"):  # by hand
            self._shown = kinds
            self._order = ModuleOrder(self._run_folder, "record", self._module or None, kinds=kinds)

    def update(self, module: str, *, is_shown: bool = True) -> None:
        """Show the kinds recorded of a module ('': of all), unless they are just being changed."""
        self._kinds.set_visibility(is_shown)
        if self._order is not None and self._order.answer is None:
            return
        if self._order is not None:
            ui.notify(self._order.answer, type="negative" if self._order.is_refused else "positive")
            self._order = None
        if module != self._module:
            self._module = module
            self._kinds.props["label"] = f"recorded of {module or 'all'}"
        recorded = read_recorded(self._run_folder)
        names = [module] if module else [name for name in recorded if name not in (SUPERVISOR, CORE)]
        found = {kind for name in names for kind in recorded.get(name, ())}
        self._shown = [str(kind) for kind in Kind if kind in found]
        self._kinds.set_value(self._shown)


class Filter:
    """The filter of a page.

    Args:
        kinds: only these kinds.
        module: only this module; '': all.
        text: only entries that contain this text, in upper or lower case.
        is_log: whether they are entries of the log that plays.
    """

    def __init__(self, kinds: Iterable[str], module: str, text: str, *, is_log: bool = False):
        self._wanted = (frozenset(kinds), module, text.casefold(), is_log)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Filter) and other._wanted == self._wanted

    __hash__ = None  # type: ignore[assignment]

    def passes(self, entry: Entry) -> bool:
        """Return whether an entry passes the filter."""
        kinds, module, text, _ = self._wanted
        return (
            entry.kind in kinds
            and module in ("", entry.module)
            and (not text or text in line_of(entry).casefold())
        )


class ShownEntries:
    """The entries that a page shows already."""

    def __init__(self) -> None:
        self.filter: Filter | None = None
        self.number = 0
        """Number of the newest entry that was checked."""
        self.reports: list[CrashReport] | None = None


def newest(entries: Sequence[Entry], wanted: Filter, after: int) -> list[Entry]:
    """Return the newest entries after a number that pass the filter, the oldest first."""
    found: list[Entry] = []
    for entry in reversed(entries):
        if entry.number <= after or len(found) == SHOWN:
            break
        if wanted.passes(entry):
            found.append(entry)
    return found[::-1]


def line_of(entry: Entry) -> str:
    """Return an entry as text, with its time in UTC."""
    head = f"{time_of_day(entry.time_s)} {entry.module}#{entry.incarnation} {entry.kind} {entry.text}"
    return f"{head}\n{entry.traceback}" if entry.traceback else head


def build_reports(reports: list[CrashReport]) -> None:
    """Build an expandable element for the report of each crash, the newest first."""
    for report in reversed(reports):
        title = f"crash of {report.module}, start {report.incarnation}: {report.reason}"
        with ui.expansion(title, icon="heart_broken").classes("w-full"):
            text = ui.label("\n".join(report.lines()))
            text.style("white-space: pre-wrap; font-family: monospace")
