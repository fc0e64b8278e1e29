"""All figures of one module: its activity, durations, message counters, log and last crash."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rich.console import Group, RenderableType
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import Screen
from textual.widgets import Footer, Static

from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.attached.views.process_table import ALARM, ModuleRow, doing, module_rows
from robbie_mp.attached.views.quantities import long_time, rate, seconds, size, sparkline
from robbie_mp.attached.views.run_figures import renamed_topics, state_text
from robbie_mp.base.utc import time_of_day
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe import TOTALS, ModuleFigures, Total
from robbie_mp.cli.top_program.feed import Snapshot, Sparklines
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.reader import crash_reports, last_entries

LOG_LINES = 20
CRASH_LINES = 60
TREND_WIDTH = 30
TIMES = {"latency": "latency", "handler": "handler", "lateness": "tick late", "tick": "tick"}


class Details(Screen[None]):
    """Shows one module until Escape.

    Args:
        module: the name of the module.
        history: the values for the sparklines.
    """

    CSS = "Details VerticalScroll { padding: 0 1; }"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,enter", "app.pop_screen", "Back"),
        Binding("r", "app.act('restart')", "Restart"),
        Binding("x", "app.act('stop')", "Stop"),
        Binding("space", "app.freeze", "Hold", key_display="␣"),
        Binding("q", "app.quit", "Quit"),
    ]

    def __init__(self, module: str, history: Sparklines):
        super().__init__()
        self.module = module
        self._history = history

    def compose(self) -> ComposeResult:
        """Build the text widget."""
        with VerticalScroll():
            yield Static(id="details")
        yield Footer(compact=True)

    def show(self, shown: Snapshot) -> None:
        """Show the present figures."""
        if shown.reading is None or not self.query("#details"):
            return  # there is no run, or the program is ending and has removed its widgets
        row = next(
            (one for one in module_rows(shown.reading, shown.rates) if one.figures.name == self.module), None
        )
        if row is None:
            return
        output = Path(shown.run.record.output_directory) if shown.run and shown.run.record else None
        parts = [*self._summary(row), *_times(row), *_subscriptions(row.figures), *_log(output, self.module)]
        self.query_one("#details", Static).update(Group(*parts))

    def _summary(self, row: ModuleRow) -> Iterable[RenderableType]:
        module, rates = row.figures, row.rates
        yield Text.assemble(
            (one_line(module.name), "bold"), "  ", state_text(module),
            f"  {one_line(module.reason)}",
            f"  pid {module.pid}  start {module.incarnation}",
            f"  up {long_time((row.now_ns - module.started_ns) / 1e9) if module.pid else '-'}",
        )  # fmt: skip
        if module.last_end:
            ago = long_time((row.now_ns - module.last_end_ns) / 1e9)
            yield Text(f"last end: {one_line(module.last_end)}, {ago} ago; {module.restarts} restarts", ALARM)
        yield doing(row)
        yield Text(
            f"memory {size(module.rss_bytes)}, {size(module.shared_bytes)} of it shared; "
            f"{module.threads} threads; own messages {module.outstanding} in "
            f"{size(module.outstanding_bytes)} of {size(module.segment_bytes)} "
            f"(limit {size(module.memory_bytes)}); pinned {module.pinned} ({size(module.pinned_bytes)}), "
            f"{module.copied} more copied"
        )
        yield Text(
            f"queue {module.waiting}/{module.queue_messages} (peak {module.waiting_peak}), "
            f"{size(module.waiting_bytes)}/{size(module.queue_bytes)}; "
            f"outbound {module.outbound_waiting}/{module.outbound_records}; refused {module.refused}, "
            f"ill-formed {module.ill_formed}; ticks missed {module.ticks_missed}; "
            f"hot path in {module.hot_path.capitalize() or '-'}"
        )
        if rates:
            for name, text in (
                ("cpu", f"{rates.cpu_percent:.0f} %"),
                ("in", f"{rate(rates.in_hz)}/s"),
                ("out", f"{rate(rates.out_hz)}/s"),
                ("latency", f"{seconds(rates.latency.p99_s)} p99"),
                ("handler", f"{seconds(rates.handler.p99_s)} p99"),
            ):
                trend = sparkline(self._history.values("module", module.name, name), TREND_WIDTH)
                yield Text.assemble(f"{name:8}", (trend, "cyan"), f"  {text}")


def _times(row: ModuleRow) -> Iterable[RenderableType]:
    work = row.figures.work
    if work is None:
        return
    table = _table("times", "count", "mean", "p50", "p99", "max", "lately", "p50", "p99", "max")
    for kind, name in TIMES.items():
        whole = getattr(work, kind).distribution()
        lately = getattr(row.rates, kind) if row.rates else None
        if whole.count:
            table.add_row(
                name, str(whole.count), seconds(whole.mean_s), seconds(whole.p50_s), seconds(whole.p99_s),
                seconds(whole.max_s),
                *((str(lately.count), seconds(lately.p50_s), seconds(lately.p99_s), seconds(lately.max_s))
                  if lately else ()),
            )  # fmt: skip
    if table.row_count:
        yield Text()
        yield table


def _counted(count: int, total: Total) -> Text:
    return Text(str(count), ALARM if count and total.problem else "")


def _subscriptions(module: ModuleFigures) -> Iterable[RenderableType]:
    if module.subscriptions:
        table = _table(
            "subscribes to", "routed", "deliv.", *(total.heading for total in TOTALS), "waiting", "handling",
        )  # fmt: skip
        for entry in module.subscriptions:
            table.add_row(
                f"{entry.type_name} {entry.topic}",
                str(entry.routed), str(entry.delivered),
                *(_counted(getattr(entry, total.name), total) for total in TOTALS), str(entry.waiting),
                "newest" if entry.handling == "KEEP_ONLY_NEWEST" else "all",
            )  # fmt: skip
        yield Text()
        yield table
    if watched := [entry for entry in module.subscriptions if entry.deadline_s]:
        table = _table("must keep coming", "age", "deadline", "late", "longest")
        for entry in watched:
            table.add_row(
                f"{entry.type_name} {entry.topic}", seconds(entry.age_s), seconds(entry.deadline_s),
                Text(str(entry.latenesses), ALARM if entry.latenesses else ""),
                seconds(entry.greatest_age_s or None),
            )  # fmt: skip
        yield Text()
        yield table
    if module.publishes:
        yield Text()
        names = (f"{name} {topic}".strip() for name, _, topic in module.publishes)
        yield Text("publishes " + one_line(", ".join(names)))
    if module.renamed:
        yield Text("topics renamed by the profile: " + one_line(", ".join(renamed_topics(module.renamed))))


def _log(output_directory: Path | None, module: str) -> Iterable[RenderableType]:
    if output_directory is None:
        return
    log = read_module_log(output_directory, module, LOG_LINES)
    if log.crash:
        yield Text()
        yield Text(f"last crash ({one_line(log.crash[0])})", ALARM)
        yield Text("\n".join(map(one_line, log.crash[1:])))
    yield Text()
    yield Text("last lines of its log", "bold")
    yield Text("\n".join(map(one_line, log.lines)) or "-", "dim" if not log.lines else "")


def _table(first: str, *headings: str) -> PlainTable:
    table = PlainTable()
    table.add_column(first)
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


@dataclass(frozen=True)
class ModuleLog:
    """The end of a module's log."""

    lines: tuple[str, ...]
    """The last lines, each entry with its time."""
    crash: tuple[str, ...]
    """Which start crashed, when and why, then the report; empty if there was no crash."""


def read_module_log(output_directory: Path, module: str, line_count: int) -> ModuleLog:
    """Read the end of a module's log. Missing files are no error.

    Args:
        output_directory: of the run.
        module: its name, or "core".
        line_count: maximum number of lines.
    """
    entries = last_entries(output_directory, module, line_count)
    lines = [f"{time_of_day(entry.time_s)} {line}" for entry in entries for line in _lines(entry)]
    return ModuleLog(tuple(lines[-line_count:]), _last_crash(output_directory, module))


def _lines(entry: Entry) -> list[str]:
    return [entry.text] if entry.crash_report else entry.lines()


def _last_crash(output_directory: Path, module: str) -> tuple[str, ...]:
    for report in crash_reports(output_directory, module, newest=1):
        title = f"start {report.incarnation}, {time_of_day(report.time_s)}, {report.reason}"
        return (title, *report.lines()[1:CRASH_LINES])
    return ()
