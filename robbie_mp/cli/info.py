"""`robbie info FILE...`: describes a recording without reading all of it, and other files."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.text import Text

from robbie_mp.attached.views import quantities
from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.base.utc import time_text
from robbie_mp.cli.file_kinds import LOG, kind_of
from robbie_mp.cli.file_kinds import describe as describe_file
from robbie_mp.cli.log_files import add_limit_argument, add_log_argument, progress_bar
from robbie_mp.cli.output import console
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.recording.info import LogInfo, describe, part_data
from robbie_mp.logs.recording.limits import READ_LIMITS, ReadLimits
from robbie_mp.logs.recording.part import LogPart
from robbie_mp.logs.recording.reader import open_log


def add_parser(subparsers: Commands) -> None:
    """Add `info` to the commands."""
    parser = add_command(
        subparsers,
        "info",
        "show what is in a recording, a bag, a map or a robot's description",
        "Show how long a recording is, which run it is from, and which messages are in it. A truncated "
        "recording is read as far as it is intact; `robbie recording repair` repairs it. Other files are "
        "known by their content: bags of ROS 1 and 2, CARMEN logs, maps, URDF, xacro and scene files. It "
        "also shows what a command that reads the file would leave out.",
        [
            "robbie info logs/monday",
            "robbie info logs/monday/monday_0000.mcap --json",
            "robbie info map.yaml",
        ],
    )
    add_log_argument(parser, nargs="+")
    add_limit_argument(parser)
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=info)


def info(arguments: argparse.Namespace) -> int:
    """Describe the recordings."""
    infos = [_describe_any(path, arguments.limits) for path in arguments.log]
    if arguments.json:
        print(json.dumps([one.as_data() for one in infos], indent=2))
        return 0
    for number, one in enumerate(infos):
        print("\n" * (number > 0), end="")
        if isinstance(one, LogInfo):
            _print(one)
        else:
            _print_other(one)
    return 0


@dataclass(frozen=True)
class _OtherFile:
    """A file that is no recording, as its reader describes it."""

    path: Path
    kind: str
    lines: dict[str, str]

    def as_data(self) -> dict[str, str]:
        """Return what `robbie info --json` prints."""
        return {"path": str(self.path), "kind": self.kind, **self.lines}


def _print_other(one: _OtherFile) -> None:
    lines = ((label, Text(text)) for label, text in one.lines.items())
    console().print(_table([("file", str(one.path)), ("kind", one.kind), *lines]))


def _describe_any(path: Path, limits: ReadLimits) -> LogInfo | _OtherFile:
    kind, file = kind_of(path)
    with progress_bar(f"reading {path}") as progress:
        if kind == LOG:
            return _describe(path, limits)
        return _OtherFile(path, kind, describe_file(kind, file, progress))


def print_log(path: Path) -> None:
    """Print the description of a recording."""
    _print(_describe(path, READ_LIMITS))


def _describe(path: Path, limits: ReadLimits) -> LogInfo:
    with open_log(path, limits) as log:
        return describe(log)


def _print(info: LogInfo) -> None:
    where = console()
    where.print(_table(_lines(info)))
    if info.channels:
        where.print()
        where.print(_channels(info))
    if len(info.parts) > 1:
        where.print()
        where.print(_parts(info))


def _table(lines: Sequence[tuple[str, str | Text]]) -> PlainTable:
    table = PlainTable(header=False)
    for name, value in lines:
        table.add_row(name, value)
    return table


def _lines(info: LogInfo) -> list[tuple[str, str | Text]]:
    lines: list[tuple[str, str | Text]] = [
        ("log", str(info.path)),
        ("messages", f"{info.messages}"),
        ("duration", f"{info.duration_s:.3f} s"),
        ("from", f"{time_text(info.start_ns / 1e9)} to {time_text(info.end_ns / 1e9)}"),
        ("size", f"{info.bytes} bytes ({quantities.size(info.bytes)}), {_compression(info)}"),
    ]
    if run := info.run:
        lines.append(("run", f"{run.run_id}, profile {run.profile}, on {run.host}"))
        lines.append(("written by", f"{info.library}, Python {run.python}"))
    else:
        lines.append(("written by", info.library or "-"))
    if info.time_jumps:
        more = [f"and {info.more_time_jumps} more"] if info.more_time_jumps else []
        lines.append(("time jumps", Text("\n".join([*map(str, info.time_jumps), *more]), "yellow")))
    lines.append(("is", _state(info)))
    if info.left_out:
        lost = "\n".join(f"{count} {reason}" for reason, count in info.left_out.items())
        lines.append(("left out", Text(lost, "bold red")))
    return lines


def _state(info: LogInfo) -> Text:
    if info.is_being_written:
        return Text("still being written; this is the complete part so far", "yellow")
    if not info.damage:
        return Text("complete")
    advice = f"; `robbie recording repair {info.path}` repairs it"
    return Text("\n".join(info.damage) + advice, "bold red")


def _compression(info: LogInfo) -> str:
    return f"compression {', '.join(info.compressions)}" if info.compressions else "without chunks"


def _channels(info: LogInfo) -> PlainTable:
    table = PlainTable()
    for heading, left_out in (("topic", 0), ("type", 0), ("version", 1), ("sender", 3)):
        table.add_column(heading, left_out=left_out, shrinks=heading != "version", no_wrap=True)
    has_latched = any(one.channel.is_latched for one in info.channels)
    for heading, left_out in (("messages", 0), ("Hz", 2), ("dropped", 5), ("carried", 4))[: 3 + has_latched]:
        table.add_column(heading, left_out=left_out, justify="right", no_wrap=True)
    for one in info.channels:
        channel = one.channel
        cells: list[str | Text] = [
            channel.topic,
            channel.type_name,
            str(channel.version),
            channel.sender,
            str(one.messages),
            quantities.rate(one.hz),
            Text("-" if one.dropped is None else str(one.dropped), "bold red" if one.dropped else ""),
            str(one.carried) if channel.is_latched else "-",
        ]
        table.add_row(*cells[: 7 + has_latched])
    return table


def _parts(info: LogInfo) -> PlainTable:
    table = PlainTable()
    table.add_column("part", shrinks=True, no_wrap=True)
    for heading, left_out in (("bytes", 2), ("messages", 0), ("chunks", 1), ("duration", 3)):
        table.add_column(heading, left_out=left_out, justify="right", no_wrap=True)
    table.add_column("is", shrinks=True, no_wrap=True)
    for part in info.parts:
        data = part_data(part)
        table.add_row(
            part.path.name,
            str(data["bytes"]),
            str(data["messages"]),
            str(data["chunks"]),
            f"{(data['end_ns'] - data['start_ns']) / 1e9:.3f} s",
            _part_state(part, data),
        )
    return table


def _part_state(part: LogPart, data: dict[str, Any]) -> str:
    if part.is_being_written:
        return "being written"
    if data["is_repaired"]:
        return "repaired"
    return "complete" if data["is_complete"] else "truncated or damaged"
