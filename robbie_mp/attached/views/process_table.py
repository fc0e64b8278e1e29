"""The text that `robbie top` shows: the same on a terminal, in a printed table, and in tests."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.text import Text

from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.attached.views.quantities import long_time, rate, seconds, size
from robbie_mp.attached.views.run_figures import STYLES, renamed_topics, state_name, state_text
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe import (
    TOTALS,
    ChannelRates,
    ModuleFigures,
    ModuleRates,
    RunRates,
    RunReading,
    Total,
)
from robbie_mp.bus.observe.talk import Talk, talk_of
from robbie_mp.bus.transport.layout import HotPath

ALARM = "bold red"
UNCONNECTED = "yellow"
HUNG_S = 1.0
"""A handler or tick that takes longer than this is shown as an alarm; the watchdog waits longer."""
SILENT_CORE_S = 1.0
BEING_STARTED = ("-", "STARTING", "BACKOFF")


@dataclass(frozen=True)
class ModuleRow:
    """One process: its figures, and its recent rates."""

    figures: ModuleFigures
    rates: ModuleRates | None
    now_ns: int

    @property
    def busy_s(self) -> float:
        """How long the process has had its present activity."""
        since_ns = self.figures.busy_since_ns
        return max(0, self.now_ns - since_ns) / 1e9 if since_ns else 0.0

    @property
    def is_hung(self) -> bool:
        """Whether one handler or tick has taken long enough to need attention."""
        return self.busy_s >= HUNG_S and self.figures.activity in ("handler", "tick", "teardown")

    @property
    def state(self) -> Text:
        """The process state, or a note that it hangs."""
        return Text("HUNG", ALARM) if self.is_hung else state_text(self.figures)


@dataclass(frozen=True)
class ModuleColumn:
    """One column of the module view."""

    heading: str
    cell: Callable[[ModuleRow], Text]
    order: Callable[[ModuleRow], float | str]
    """Sort key of the rows; numbers sort largest first."""
    is_text: bool = False
    is_line: bool = False
    """Whether the text may be long."""


def module_rows(reading: RunReading, rates: RunRates | None) -> list[ModuleRow]:
    """Return a row for each process, in start order."""
    return [
        ModuleRow(module, rates.modules.get(module.name) if rates else None, reading.at_ns)
        for module in reading.modules
    ]


def doing(row: ModuleRow) -> Text:
    """The status of a process. If the process seems to hang, the text begins with its activity."""
    module = row.figures
    state = state_name(module)
    if state in ("BACKOFF", "FAILED"):
        return Text(one_line(module.reason), STYLES[state])
    if state == "STOPPED":
        return Text(one_line(module.reason), "dim")
    parts = []
    if row.is_hung:
        parts.append((f"in {module.handler or module.activity} for {row.busy_s:.1f} s", ALARM))
    if module.health:
        parts.append((module.health, ALARM))
    if module.states:
        parts.append((f"[{module.states}]", "bold"))
    if module.status:
        parts.append((module.status, ""))
    parts += [(str(one), UNCONNECTED) for one in module.unconnected]
    return Text("  ").join(Text(one_line(text), style) for text, style in parts)


def _number(value: float, text: str, *, alarm: bool = False, quiet: bool = True) -> Text:
    return Text(text, ALARM if alarm and value else "dim" if quiet and not value else "", justify="right")


def _of(heading: str, value: Callable[[ModuleFigures], float], *, alarm: bool = False) -> ModuleColumn:
    return ModuleColumn(
        heading,
        lambda row: _number(value(row.figures), f"{value(row.figures):.0f}", alarm=alarm),
        lambda row: value(row.figures),
    )


def _bytes(heading: str, value: Callable[[ModuleFigures], float]) -> ModuleColumn:
    return ModuleColumn(
        heading,
        lambda row: _number(value(row.figures), size(value(row.figures))),
        lambda row: value(row.figures),
    )


def _rate(heading: str, name: str) -> ModuleColumn:
    def value(row: ModuleRow) -> float:
        return float(getattr(row.rates, name)) if row.rates else 0.0

    return ModuleColumn(
        heading, lambda row: _number(value(row), rate(value(row)) if row.rates else "-"), value
    )


def _time(heading: str, kind: str, part: str) -> ModuleColumn:
    """Make a column of recent times, or of the whole incarnation if there are no recent ones."""

    def value(row: ModuleRow) -> float | None:
        if row.rates:
            times = getattr(row.rates, kind)
        elif row.figures.work:
            times = getattr(row.figures.work, kind).distribution()
        else:
            return None
        found: float | None = getattr(times, part)
        return found

    return ModuleColumn(
        heading,
        lambda row: _number(value(row) or 0, seconds(value(row))),
        lambda row: value(row) or 0.0,
    )


def _queue(row: ModuleRow) -> Text:
    module = row.figures
    if not module.queue_messages:
        return Text("-", "dim", justify="right")
    full = module.waiting >= module.queue_messages or module.waiting_bytes >= module.queue_bytes
    text = f"{module.waiting}/{module.queue_messages}"
    style = ALARM if full else "yellow" if 2 * module.waiting >= module.queue_messages else ""
    return Text(text, style or ("" if module.waiting else "dim"), justify="right")


def _outbound(row: ModuleRow) -> Text:
    module = row.figures
    if not module.outbound_records:
        return Text("-", "dim", justify="right")
    text = f"{module.outbound_waiting}/{module.outbound_records}"
    return _number(module.outbound_waiting, text)


def _hot_path(name: str) -> Text:
    """Show C or Python; Python is slower."""
    return Text(name.capitalize() or "-", "yellow" if name == HotPath.PYTHON.name else "dim")


def _memory_used(row: ModuleRow) -> Text:
    module = row.figures
    if not module.memory_bytes:
        return Text("-", "dim", justify="right")
    full = module.outstanding_bytes > 0.9 * module.memory_bytes
    text = f"{size(module.outstanding_bytes)}/{size(module.memory_bytes)}"
    return Text(text, ALARM if full else "" if module.outstanding_bytes else "dim", justify="right")


def _uptime_s(row: ModuleRow) -> float:
    return (row.now_ns - row.figures.started_ns) / 1e9 if row.figures.pid else 0.0


def _total(total: Total) -> ModuleColumn:
    return _of(total.short, lambda module: module.total(total.name), alarm=bool(total.problem))


_TOTALS = {total.name: _total(total) for total in TOTALS}
MODULE_COLUMNS: tuple[ModuleColumn, ...] = (
    ModuleColumn(
        "module",
        lambda row: Text(one_line(row.figures.name), "bold"),
        lambda row: row.figures.name,
        is_text=True,
    ),
    ModuleColumn(
        "state",
        lambda row: row.state,
        lambda row: row.state.plain,
        is_text=True,
    ),
    _of("rst", lambda module: module.restarts, alarm=True),
    _rate("cpu%", "cpu_percent"),
    _rate("in/s", "in_hz"),
    _TOTALS.pop("overflowed"),
    ModuleColumn("status", doing, lambda row: doing(row).plain, is_text=True, is_line=True),
    _rate("out/s", "out_hz"),
    _bytes("mem", lambda module: module.rss_bytes),
    ModuleColumn("queue", _queue, lambda row: row.figures.waiting),
    _time("lat p99", "latency", "p99_s"),
    _time("hnd p99", "handler", "p99_s"),
    _time("lat p50", "latency", "p50_s"),
    _time("hnd mean", "handler", "mean_s"),
    _time("hnd max", "handler", "max_s"),
    _time("tick p99", "tick", "p99_s"),
    _time("late p99", "lateness", "p99_s"),
    _of("missed", lambda module: module.ticks_missed, alarm=True),
    _of("peak", lambda module: module.waiting_peak),
    ModuleColumn("outq", _outbound, lambda row: row.figures.outbound_waiting),
    *_TOTALS.values(),
    _of("refused", lambda module: module.refused, alarm=True),
    _of("pinned", lambda module: module.pinned),
    _bytes("pin mem", lambda module: module.pinned_bytes),
    _of("copied", lambda module: module.copied),
    _of("ill", lambda module: module.ill_formed, alarm=True),
    ModuleColumn("msg mem", _memory_used, lambda row: row.figures.outstanding_bytes),
    ModuleColumn(
        "code",
        lambda row: _hot_path(row.figures.hot_path),
        lambda row: row.figures.hot_path,
        is_text=True,
    ),
    _rate("wake/s", "wakeups_hz"),
    _of("thr", lambda module: module.threads),
    _of("pid", lambda module: module.pid),
    ModuleColumn(
        "up",
        lambda row: Text(long_time(_uptime_s(row)) if row.figures.pid else "-", justify="right"),
        _uptime_s,
    ),
    ModuleColumn(
        "renamed topics",
        lambda row: Text(one_line(", ".join(renamed_topics(row.figures.renamed)))),
        lambda row: ", ".join(renamed_topics(row.figures.renamed)),
        is_text=True,
        is_line=True,
    ),
    ModuleColumn(
        "last end",
        lambda row: Text(one_line(row.figures.last_end)),
        lambda row: row.figures.last_end,
        is_text=True,
        is_line=True,
    ),
)
PRINTED = (
    "module", "state", "cpu%", "mem", "in/s", "out/s", "queue", "drop", "repl", "lost", "refused",
    "lat p99 ms", "hnd p99 ms", "rst", "up", "status",
)  # fmt: skip
LEFT_OUT = (
    "up", "repl", "refused", "hnd p99 ms", "queue", "mem", "lost", "lat p99 ms", "out/s", "in/s", "cpu%",
    "drop", "rst",
)  # fmt: skip
"""Columns that a narrow terminal does not show, the least important one first."""


def _whole_time_ms(heading: str, kind: str) -> ModuleColumn:
    """p99 over the whole incarnation, always in ms, so that people and programs can compare tables."""

    def value(row: ModuleRow) -> float | None:
        work = row.figures.work
        found: float | None = getattr(work, kind).distribution().p99_s if work else None
        return found

    return ModuleColumn(
        heading,
        lambda row: Text("-" if (time_s := value(row)) is None else f"{time_s * 1e3:.2f}", justify="right"),
        lambda row: value(row) or 0.0,
    )


PRINTED_TIMES = (_whole_time_ms("lat p99 ms", "latency"), _whole_time_ms("hnd p99 ms", "handler"))


def modules_table(reading: RunReading, rates: RunRates | None) -> PlainTable:
    """Make the table of the most important figures, for printing."""
    columns = [column for column in (*MODULE_COLUMNS, *PRINTED_TIMES) if column.heading in PRINTED]
    columns.sort(key=lambda column: PRINTED.index(column.heading))
    made = PlainTable()
    for column in columns:
        is_last = column.heading == "status"
        made.add_column(
            column.heading,
            left_out=LEFT_OUT.index(column.heading) + 1 if column.heading in LEFT_OUT else 0,
            shrinks=is_last,
            justify="left" if column.is_text else "right",
            no_wrap=not is_last,
        )
    for row in module_rows(reading, rates):
        cells = [column.cell(row) for column in columns]
        cells[-1].no_wrap, cells[-1].overflow = True, "ellipsis"
        made.add_row(*cells)
    return made


def totals_line(reading: RunReading, rates: RunRates | None) -> Text:
    """Summarize the whole run and its machine in one line."""
    core, machine = reading.core, reading.machine
    parts = [Text(f"up {long_time((reading.at_ns - reading.modules[0].started_ns) / 1e9)}")]
    silent_s = (reading.at_ns - core.heartbeat_ns) / 1e9
    if silent_s > SILENT_CORE_S:
        parts.append(Text(f"CORE SILENT {silent_s:.1f} s" if core.heartbeat_ns else "CORE NOT UP", ALARM))
    parts += [Text("core in Python", "yellow")] if reading.modules[-1].hot_path == HotPath.PYTHON.name else []
    if not reading.messages_flow:
        awaited = [module.name for module in reading.modules[1:-1] if state_name(module) in BEING_STARTED]
        parts.append(Text(one_line(f"the start waits for {', '.join(awaited) or 'the core'}"), "cyan"))
    if alone := sum(len(module.unconnected) for module in reading.modules):
        parts.append(Text(f"{alone} UNCONNECTED", UNCONNECTED))
    if core.latched_not_given:
        parts.append(Text(f"{core.latched_not_given} LATCHED NOT GIVEN", ALARM))
    if rates:
        parts.append(Text(f"routed {rate(rates.routed_hz)}/s"))
        parts.append(Text("cpu " + " ".join(f"{percent:.0f}%" for percent in rates.cpu_percent)))
    parts.append(Text("load " + " ".join(f"{load:.1f}" for load in machine.load)))
    used, total = machine.shared_memory_used_bytes, machine.shared_memory_total_bytes
    parts.append(Text(f"shm {size(used)}/{size(total)}", ALARM if used > 0.9 * total else ""))
    fill = core.handles / max(1, core.handles_limit)
    parts.append(Text(f"msgs {core.handles}", ALARM if fill > 0.9 else ""))
    return Text("  ").join(parts)


@dataclass(frozen=True)
class ChannelLine:
    """One channel with its publishers and subscribers."""

    talk: Talk
    rates: ChannelRates | None
    now_ns: int

    @property
    def age_s(self) -> float | None:
        """Time since the last message; None if there was none."""
        last_ns = self.talk.channel.last_ns
        return max(0, self.now_ns - last_ns) / 1e9 if last_ns else None

    @property
    def key(self) -> tuple[str, str, str]:
        """Type, version and topic."""
        channel = self.talk.channel
        return channel.type_name, str(channel.version), channel.topic

    @property
    def name(self) -> str:
        """Type and topic as shown."""
        channel = self.talk.channel
        type_name = channel.type_name.replace("/msg/", "/")
        return one_line(f"{type_name} {channel.topic}" if channel.topic else type_name)


@dataclass(frozen=True)
class ChannelColumn:
    """One column of the message view."""

    heading: str
    cell: Callable[[ChannelLine], Text]
    order: Callable[[ChannelLine], float | str]
    is_text: bool = False
    is_line: bool = False
    """Whether the text may be long."""


def _names(names: Sequence[str]) -> Text:
    return Text(one_line(", ".join(names)) or "-", "" if names else "dim")


def _rate_of(row: ChannelLine, name: str) -> float:
    return float(getattr(row.rates, name) or 0.0) if row.rates else 0.0


CHANNEL_COLUMNS: tuple[ChannelColumn, ...] = (
    ChannelColumn("message, topic", lambda row: Text(row.name, "bold"), lambda row: row.name, is_text=True),
    ChannelColumn(
        "rate",
        lambda row: _number(_rate_of(row, "hz"), rate(_rate_of(row, "hz"))),
        lambda row: _rate_of(row, "hz"),
    ),
    ChannelColumn(
        "B/s",
        lambda row: _number(_rate_of(row, "bytes_per_s"), size(_rate_of(row, "bytes_per_s"))),
        lambda row: _rate_of(row, "bytes_per_s"),
    ),
    ChannelColumn(
        "jitter",
        lambda row: _number(1, seconds(row.rates.jitter_s if row.rates else None)),
        lambda row: _rate_of(row, "jitter_s"),
    ),
    ChannelColumn("age", lambda row: _number(1, seconds(row.age_s)), lambda row: row.age_s or 0.0),
    ChannelColumn(
        "from",
        lambda row: _names(row.talk.publishers),
        lambda row: ", ".join(row.talk.publishers),
        is_text=True,
    ),
    ChannelColumn(
        "to",
        lambda row: _names([name for name, _ in row.talk.subscribers]),
        lambda row: ", ".join(name for name, _ in row.talk.subscribers),
        is_text=True,
    ),
    ChannelColumn(
        "total",
        lambda row: _number(row.talk.channel.messages, str(row.talk.channel.messages)),
        lambda row: row.talk.channel.messages,
    ),
)


def channel_rows(reading: RunReading, rates: RunRates | None) -> list[ChannelLine]:
    """Return a row for each channel, by type and topic."""
    return [
        ChannelLine(
            talk,
            rates.channels.get((talk.channel.type_name, talk.channel.version, talk.channel.topic))
            if rates
            else None,
            reading.at_ns,
        )
        for talk in talk_of(reading)
    ]


def graph(reading: RunReading, rates: RunRates | None) -> Text:
    """The communication graph: each module with its channels and their receivers."""
    lines: list[Text] = []
    rows = channel_rows(reading, rates)
    for module in reading.modules:
        sent = [row for row in rows if module.name in row.talk.publishers]
        heard = [row for row in rows if module.name in [name for name, _ in row.talk.subscribers]]
        if not sent and not heard:
            continue
        style = STYLES.get(state_name(module), "")
        lines.append(
            Text.assemble((one_line(module.name), f"bold {style}"), "" if sent else ("  only listens", "dim"))
        )
        for place, row in enumerate(sent):
            corner = "└─" if place == len(sent) - 1 else "├─"
            hz = f" {rate(_rate_of(row, 'hz'))}/s" if row.rates else ""
            line = Text.assemble(f"{corner} {row.name}", (hz, "cyan"), " ─▶ ")
            if not row.talk.subscribers:
                line.append("nobody", "dim")
            for number, (name, entry) in enumerate(row.talk.subscribers):
                line.append(", " if number else "")
                line.append(one_line(name), "bold")
                if entry.handling == "KEEP_ONLY_NEWEST":
                    line.append(" (newest)", "dim")
                if entry.overflowed:
                    line.append(f" {entry.overflowed} dropped", ALARM)
            lines.append(line)
    unheard = [row for row in rows if not row.talk.publishers and row.talk.subscribers]
    for row in unheard:
        names = one_line(", ".join(name for name, _ in row.talk.subscribers))
        lines.append(Text.assemble(("nobody", "dim"), f" ─ {row.name} ─▶ {names}"))
    return Text("\n").join(lines) if lines else Text("no module publishes or subscribes", "dim")
