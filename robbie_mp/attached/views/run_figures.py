"""Figures of a run, as a table to read and as plain data for programs (see docs/reference.md)."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, fields
from functools import partial
from typing import Any

from rich.text import Text

from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.base.utc import time_text
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe import (
    TOTALS,
    ChannelRates,
    ModuleFigures,
    RunRates,
    RunReading,
    Total,
    WorkHistograms,
)
from robbie_mp.bus.observe.talk import Talk, talk_of
from robbie_mp.bus.transport.tables import COLUMNS
from robbie_mp.run.run_directory import KnownRun
from robbie_mp.run.supervisor import states
from robbie_mp.run.supervisor.states import ChildState

DEGRADED = "DEGRADED"
"""Shown in place of the state of a module that runs but is not well."""
STYLES = {
    "RUNNING": "green",
    DEGRADED: "bold yellow",
    "STARTING": "cyan",
    "BACKOFF": "yellow",
    "FAILED": "bold red",
    "STOPPED": "dim",
}


def state_name(figures: ModuleFigures) -> str:
    """The state in words; '-' if there is none (the supervisor, or a process that never started)."""
    return states.state_name(figures.state)


def state_text(figures: ModuleFigures) -> Text:
    """The state with its colour, or that the module runs but is DEGRADED."""
    state = state_name(figures)
    shown = DEGRADED if figures.health and state == ChildState.RUNNING else state
    return Text(shown, STYLES.get(shown, ""))


def table(modules: Sequence[ModuleFigures], *, live: bool, columns: Sequence[str] = ()) -> PlainTable:
    """Make a table with one row per module.

    Args:
        modules: the figures; the supervisor's row is left out, as it sends and takes no messages itself.
        live: whether the modules run, so that the table shows their status lines.
        columns: which of `FIGURES` to show; all by default.
    """
    made = PlainTable()
    made.add_column("module", no_wrap=True)
    made.add_column("state", no_wrap=True)
    for heading in columns or FIGURES:
        made.add_column(heading, left_out=LEFT_OUT.index(heading) + 1, justify="right", no_wrap=True)
    if live:
        made.add_column("status", shrinks=True)
    for module in modules[1:]:
        made.add_row(
            module.name,
            state_text(module),
            *(FIGURES[heading](module) for heading in columns or FIGURES),
            *([Text(one_line(_live_line(module)), no_wrap=True, overflow="ellipsis")] if live else []),
        )
    return made


def renamed_topics(renamed: Iterable[tuple[str, str]]) -> list[str]:
    """The topics that the profile renamed: the module's own names, and those in the run."""
    return [f"{own or NO_TOPIC} → {actual or NO_TOPIC}" for own, actual in renamed]


def said(module: ModuleFigures) -> str:
    """Return the states and the status line of a module, as it shows them."""
    return "  ".join(filter(None, (f"[{module.states}]" if module.states else "", module.status)))


def _live_line(module: ModuleFigures) -> str:
    return "  ".join(filter(None, (module.health, said(module), *map(str, module.unconnected))))


def _alarming(count: int) -> Text:
    return Text(str(count), "bold red" if count else "")


def _total(total: Total, module: ModuleFigures) -> Text:
    count = module.total(total.name)
    return _alarming(count) if total.problem else Text(str(count))


FIGURES: dict[str, Callable[[ModuleFigures], Text]] = {
    "cpu s": lambda module: Text(f"{module.cpu_s:.1f}"),
    "restarts": lambda module: _alarming(module.restarts),
    "in": lambda module: Text(str(module.handled)),
    "out": lambda module: Text(str(module.published)),
    "waiting": lambda module: Text(str(module.waiting)),
    **{total.heading: partial(_total, total) for total in TOTALS},
    "refused": lambda module: _alarming(module.refused),
}
LEFT_OUT = ("left", "waiting", "replaced", "refused", "cpu s", "lost", "out", "in", "dropped", "restarts")
"""The figures that a narrow terminal does not show, the least important one first."""
LIVE_FIGURES = ("cpu s", "restarts", "in", "out", "dropped")
"""The figures that leave room for the status line in 80 columns."""

NO_TOPIC = "''"
SCHEMA = 1
"""Increase this when a key of `run_as_data` is removed or changes its meaning."""
TIMES = tuple(field.name for field in fields(WorkHistograms))
_AS_THEY_ARE = tuple(
    field.name
    for field in fields(ModuleFigures)
    if field.name not in ("state", "work", "publishes", "subscriptions", "unconnected", "renamed")
)


def as_data(module: ModuleFigures, now_ns: int | None = None) -> dict[str, Any]:
    """Return everything known of a module since it started."""
    now_ns = time.monotonic_ns() if now_ns is None else now_ns
    state, work = state_name(module), module.work
    running = state == ChildState.RUNNING
    return {
        **{name: getattr(module, name) for name in _AS_THEY_ARE},
        "state": state,
        "uptime_s": (now_ns - module.started_ns) / 1e9 if running else 0.0,
        "busy_s": (now_ns - module.busy_since_ns) / 1e9 if module.busy_since_ns else 0.0,
        **{column: module.total(column) for column in (*COLUMNS, "left")},
        "times": {kind: asdict(getattr(work, kind).distribution()) for kind in TIMES} if work else None,
        "subscriptions": [{**asdict(entry), "waiting": entry.waiting} for entry in module.subscriptions],
        "publishes": [
            {"type_name": name, "version": version, "topic": topic}
            for name, version, topic in module.publishes
        ],
        "renamed": dict(module.renamed),
        "unconnected": [asdict(entry) for entry in module.unconnected],
    }


def run_as_data(run: KnownRun, now: RunReading, rates: RunRates | None) -> dict[str, Any]:
    """Return everything known of a run.

    Args:
        run: the run.
        now: the reading.
        rates: since the previous reading; None if there is none.
    """
    return {
        "schema": SCHEMA,
        "run_id": run.run_id,
        "profile": run.record.profile if run.record else "",
        "time": time_text(now.wall_time_s),
        "uptime_s": (now.at_ns - now.modules[0].started_ns) / 1e9,
        "interval_s": rates.interval_s if rates else None,
        "messages_flow": now.messages_flow,
        "routed": now.core.routed,
        "routed_hz": rates.routed_hz if rates else None,
        "core": {
            **asdict(now.core),
            "heartbeat_age_s": (now.at_ns - now.core.heartbeat_ns) / 1e9,
            "wakeups_hz": rates.wakeups_hz if rates else None,
        },
        "machine": {**asdict(now.machine), "cpu_percent": rates.cpu_percent if rates else None},
        "modules": [
            {**as_data(module, now.at_ns), "rates": _module_rates(module.name, rates)}
            for module in now.modules
        ],
        "channels": [_channel(talk, now.at_ns, rates) for talk in talk_of(now)],
        "segments": [asdict(segment) for segment in now.segments],
    }


def _module_rates(name: str, rates: RunRates | None) -> dict[str, Any] | None:
    if rates is None:
        return None
    data = asdict(rates.modules[name])
    return {**data, "times": {kind: data.pop(kind) for kind in TIMES}}


def _channel(talk: Talk, now_ns: int, rates: RunRates | None) -> dict[str, Any]:
    channel = talk.channel
    key = channel.type_name, channel.version, channel.topic
    found = rates.channels[key] if rates else None
    return {
        "type_name": channel.type_name,
        "version": channel.version,
        "topic": channel.topic,
        "messages": channel.messages,
        "bytes": channel.bytes,
        "age_s": (now_ns - channel.last_ns) / 1e9 if channel.last_ns else None,
        **{field.name: found and getattr(found, field.name) for field in fields(ChannelRates)},
        "publishers": list(talk.publishers),
        "subscribers": [name for name, _ in talk.subscribers],
    }
