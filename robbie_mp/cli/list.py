"""`robbie list`: the runs on this machine, or the modules, message types and topics of one."""

import argparse
import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from typing import Any

from rich.text import Text

from robbie_mp.attached.views import quantities
from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.attached.views.run_figures import STYLES, renamed_topics, said, state_name
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.observe.latched import latched_bytes
from robbie_mp.bus.transport.declarations import ObservedDeclaration, read_declarations
from robbie_mp.bus.transport.segment import SegmentMismatch, SegmentMissing
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.cli.addresses import add_address_argument, endpoints_of
from robbie_mp.cli.output import console
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run, live_runs
from robbie_mp.connect.link.wire import Endpoints, find_robots
from robbie_mp.messages.calls import GOAL_SUFFIX, REQUEST_SUFFIX
from robbie_mp.module.calls.peers import topic_of_service
from robbie_mp.run.run_directory import KnownRun

Row = dict[str, Any]
PAST = "past_publishers"
"""Key of a topic's modules that do not publish now, with their states: they have ended."""
RENAMED, HEALTH, REASON = "renamed", "health", "reason"
LATCHED, KEPT = "latched", "latched_bytes"
"""Keys of a topic: whether it is latched, and the size of the message that the core keeps of it."""
NO_STATES = "starting, or of another version of Robbie-MP"


def add_parser(subparsers: Commands) -> None:
    """Add `list` to the commands."""
    parser = add_command(
        subparsers,
        "list",
        "list runs, or the modules, message types, topics or services of one",
        "List the runs on this machine and their modules, or the modules, message types, topics or services "
        "of one run. This costs the robot nothing.",
        [
            "robbie list",
            "robbie list topics",
            "robbie list modules --json",
            "robbie list --remote --at tcp/192.168.0.7:7447",
        ],
    )
    parser.add_argument(
        "what", nargs="?", choices=["runs", *TABLES], default="runs", help="what to list (runs)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.add_argument(
        "--remote", action="store_true", help="list the robots that can be reached over a network instead"
    )
    add_address_argument(parser)
    add_run_argument(parser)
    parser.set_defaults(command=list_what)


def list_what(arguments: argparse.Namespace) -> int:
    """Print the requested list."""
    if arguments.remote:
        return _list_robots(endpoints_of(arguments), arguments.json)
    if arguments.what == "runs":
        return _list_runs(arguments.json)
    rows = TABLES[arguments.what](choose_run(arguments.run))
    if arguments.json:
        print(json.dumps(rows, indent=2))
    elif not rows:
        print(f"no {arguments.what} yet")
    else:
        _print(rows)
    return 0


def _list_robots(endpoints: Endpoints, as_json: bool) -> int:
    robots = find_robots(endpoints)
    if as_json:
        print(json.dumps(robots, indent=2))
    elif robots:
        print("\n".join(robots))
    else:
        print(f"no robot can be reached at {', '.join(endpoints.connect)}")
    return 0


def _modules(run: KnownRun) -> list[Row]:
    with closing(RunObserver(run.run_id)) as observer:
        return [
            {
                "module": module.name,
                "state": state_name(module),
                "pid": module.pid,
                "restarts": module.restarts,
                HEALTH: module.health,
                "status": said(module),
                REASON: module.reason if state_name(module) in ("BACKOFF", "FAILED") else "",
                RENAMED: renamed_topics(module.renamed),
            }
            for module in observer.modules()[1:]
        ]


def _types(run: KnownRun) -> list[Row]:
    rows: dict[tuple[str, int], Row] = {}
    for topic in _topics(run):
        row = rows.setdefault(
            (topic["type"], topic["version"]),
            {"type": topic["type"], "version": topic["version"], "topics": 0, "messages": 0, "bytes": 0},
        )
        row["topics"] += 1
        row["messages"] += topic["messages"]
        row["bytes"] += topic["bytes"]
    return list(rows.values())


def _topics(run: KnownRun) -> list[Row]:
    """Return a row for each pair of type and topic that is published or subscribed to."""
    declared = read_declarations(run.run_id)
    latched = latched_bytes(run.run_id)
    with closing(RunObserver(run.run_id)) as observer:
        counts = {(entry.type_name, entry.version, entry.topic): entry for entry in observer.channels()}
        states = {module.name: state_name(module) for module in observer.modules()}
    keys = {
        (entry.type_name, entry.version, entry.topic)
        for entry in declared
        if entry.is_publisher or not (entry.is_by_patterns or _is_published(entry, declared))
    }
    rows = []
    for type_name, version, topic in sorted({*keys, *counts}):
        count = counts.get((type_name, version, topic))
        name = ChannelName(type_name, version, topic)
        publishers = [e.module for e in declared if e.is_publisher and e.name == name]
        past = [module for module in (count.publishers if count else ()) if module not in publishers]
        rows.append(
            {
                "type": type_name,
                "version": version,
                "topic": topic,
                "messages": count.messages if count else 0,
                "bytes": count.bytes if count else 0,
                "publishers": publishers,
                PAST: {module: states.get(module, "-") for module in past},
                "subscribers": _subscribers(name, declared),
                LATCHED: name in latched,
                KEPT: latched.get(name, 0),
            }
        )
    return rows


def _is_published(wanted: ObservedDeclaration, declared: Sequence[ObservedDeclaration]) -> bool:
    return any(entry.is_publisher and wanted.name.takes(entry.name) for entry in declared)


def _subscribers(name: ChannelName, declared: Sequence[ObservedDeclaration]) -> list[str]:
    """Return the modules that subscribe to a channel, each once even if several of its patterns match."""
    modules = [entry.module for entry in declared if not entry.is_publisher and entry.name.takes(name)]
    return list(dict.fromkeys(modules))


def _services(run: KnownRun) -> list[Row]:
    """Return a row for each service and action of a module that runs."""
    with closing(RunObserver(run.run_id)) as observer:
        counts = {(entry.type_name, entry.version, entry.topic): entry for entry in observer.channels()}
    rows = []
    for entry in read_declarations(run.run_id):
        topic = None if entry.is_publisher else topic_of_service(entry.topic)
        base = entry.type_name.removesuffix(REQUEST_SUFFIX).removesuffix(GOAL_SUFFIX)
        if topic is not None and base != entry.type_name:
            count = counts.get(entry.name)
            rows.append(
                {
                    "service": base,
                    "version": entry.version,
                    "topic": topic,
                    "server": entry.module,
                    "requests": count.messages if count else 0,
                }
            )
    return sorted(rows, key=lambda row: (row["service"], row["topic"]))


TABLES = {"modules": _modules, "types": _types, "topics": _topics, "services": _services}


def _with_past_publishers(row: Row) -> Row:
    """Show the modules that published before they ended beside those that run."""
    past = [f"{module} ({state})" for module, state in row[PAST].items()]
    shown = {heading: value for heading, value in row.items() if heading != PAST}
    return {**shown, "publishers": [*row["publishers"], *past]}


def _with_kept_bytes(row: Row) -> Row:
    """Show the size of a latched topic's newest message in one column."""
    shown = {heading: value for heading, value in row.items() if heading != KEPT}
    return {**shown, LATCHED: quantities.size(row[KEPT]) if row[LATCHED] else "-"}


LEFT_OUT = ("version", "bytes", "pid", RENAMED, "topics", LATCHED, "subscribers", "publishers", "restarts")
"""Columns that a narrow terminal does not show, the least important one first."""
SHRINKING = ("type", "topic", "status", RENAMED, HEALTH, REASON)
"""Columns of texts that are shortened on a narrow terminal, as lists are."""


def _print(rows: Sequence[Row]) -> None:
    table = PlainTable()
    if PAST in rows[0]:
        rows = [_with_kept_bytes(_with_past_publishers(row)) for row in rows]
    unused = {heading for heading in (RENAMED, HEALTH, REASON) if not any(row.get(heading) for row in rows)}
    rows = [{heading: value for heading, value in row.items() if heading not in unused} for row in rows]
    for heading, value in rows[0].items():
        table.add_column(
            heading,
            left_out=LEFT_OUT.index(heading) + 1 if heading in LEFT_OUT else 0,
            shrinks=isinstance(value, list) or heading in SHRINKING,
            justify="right" if isinstance(value, int) else "left",
            no_wrap=True,
        )
    for row in rows:
        cells = (", ".join(value) if isinstance(value, list) else str(value) for value in row.values())
        table.add_row(*(Text(one_line(cell), STYLES.get(cell, "")) for cell in cells))
    console().print(table)


def _list_runs(as_json: bool) -> int:
    runs = [(run, _states(run)) for run in live_runs()]
    if as_json:
        print(json.dumps([_as_data(run, states) for run, states in runs], indent=2))
        return 0
    if not runs:
        print("no run on this machine; start one with `robbie run PROFILE`")
        return 0
    table = PlainTable()
    for place, heading in enumerate(("run", "profile", "supervisor", "since", "modules")):
        left_out = {"supervisor": 1, "since": 2}.get(heading, 0)
        table.add_column(heading, left_out=left_out, shrinks=heading == "modules", no_wrap=place < 4)
    for run, states in runs:
        record = run.record
        shown = ", ".join(f"{name} {state}" for name, state in states.items()) or NO_STATES
        if record is not None:
            since = f"{record.started_at[:19]}Z"
            table.add_row(run.run_id, record.profile, str(record.supervisor_pid), since, shown)
    console().print(table)
    return 0


def _states(run: KnownRun) -> dict[str, str]:
    """Return states by module name; empty if the run has no shared memory yet, or of another version."""
    try:
        observer = RunObserver(run.run_id)
    except (SegmentMissing, SegmentMismatch):
        return {}
    states = {module.name: state_name(module) for module in observer.modules()[1:]}
    observer.close()
    return states


def _as_data(run: KnownRun, states: dict[str, str]) -> dict[str, object]:
    return {**(asdict(run.record) if run.record else {"run_id": run.run_id}), "modules": states}
