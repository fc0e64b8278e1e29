"""`robbie log`: what the processes of a run have logged, during the run or after it."""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from rich.style import Style

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.utc import time_of_day
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli import completers
from robbie_mp.cli.amounts import whole_between
from robbie_mp.cli.output import console, print_styled
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_robot_argument, add_run_argument, choose_run, live_runs
from robbie_mp.run.control import control
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.reader import LOG_FOLDER, TraceFollower, crash_reports, entries, module_names

POLL_S = 0.1
FOLLOWED_LINES = 20
STYLES = {
    Kind.ERROR: Style(color="red", bold=True),
    Kind.WARNING: Style(color="yellow"),
    Kind.INFO: Style.null(),
    Kind.SYSTEM: Style(dim=True),
}


class NoTrace(RobbieError, LookupError):
    """There is no trace to show.

    Example scenarios:
      - the folder is not the output directory of a run
      - no module has the name given with --module
    """


def add_parser(subparsers: Commands) -> None:
    """Add `log` to the commands."""
    parser = add_command(
        subparsers,
        "log",
        "show what modules have logged and printed, and why they crashed",
        "Show the trace of a live run, of the newest run in ./output, or of the run in DIR. "
        "log/trace.html in the run's output directory shows the same in a browser.",
        [
            "robbie log --module laser --last 50",
            "robbie log --follow --kind error,warning",
            "robbie log --crashes output/demo/20260101T120000Z-4711",
            "robbie log --record error,warning,info,system --module laser",
        ],
    )
    parser.add_argument("directory", metavar="DIR", nargs="?", type=Path, help="output directory of a run")
    add_run_argument(parser)
    add_robot_argument(parser)
    parser.add_argument(
        "--kind",
        metavar="KINDS",
        type=_kinds,
        help=f"show only these kinds, separated by commas: {','.join(Kind)}",
    )
    module = parser.add_argument("--module", metavar="NAME", help="show only this module, core or supervisor")
    module.completer = completers.modules  # type: ignore[attr-defined]
    parser.add_argument("--last", metavar="N", type=whole_between(0), help="show only the last N entries")
    parser.add_argument("--follow", action="store_true", help="show new entries until the run ends")
    parser.add_argument("--crashes", action="store_true", help="show crash reports instead")
    parser.add_argument("--json", action="store_true", help="print each entry as one line of JSON")
    parser.add_argument(
        "--record",
        metavar="KINDS",
        type=_kinds,
        help="record only these kinds from now on, for all modules or --module; none: nothing",
    )
    parser.set_defaults(command=log)


def log(arguments: argparse.Namespace) -> int:
    """Show a trace, or change the recorded kinds."""
    if arguments.record is not None:
        run = choose_run(arguments.run)
        print(control(run.folder, "record", arguments.module, kinds=sorted(arguments.record)))
        return 0
    directory = _directory(arguments)
    names = module_names(directory)
    if arguments.module not in (None, *names):
        near = did_you_mean(arguments.module, names) or f"; there are {', '.join(names) or 'none'}"
        raise NoTrace(f"{arguments.module!r} has no entries in {directory / LOG_FOLDER}{near}")
    if arguments.crashes:
        _print_crashes(directory, arguments)
        return 0
    printer = EntryPrinter(as_json=arguments.json)
    for entry in _chosen(directory, arguments):
        printer.print(entry)
    return 0


def _chosen(directory: Path, arguments: argparse.Namespace) -> Iterator[Entry]:
    modules = None if arguments.module is None else [arguments.module]
    kinds = frozenset(Kind) if arguments.kind is None else arguments.kind
    if not arguments.follow:
        fitting = (entry for entry in entries(directory, modules) if entry.kind in kinds)
        yield from fitting if arguments.last is None else _last(list(fitting), arguments.last)
        return
    follower = TraceFollower(directory, modules)
    count = FOLLOWED_LINES if arguments.last is None else arguments.last
    yield from _last([entry for entry in follower.read_new() if entry.kind in kinds], count)
    is_live = True
    while is_live:
        is_live = _is_live(directory)  # before reading, so that the last entries are not missed
        yield from (entry for entry in follower.read_new() if entry.kind in kinds)
        sys.stdout.flush()
        time.sleep(POLL_S)


def _last(found: list[Entry], count: int) -> list[Entry]:
    return found[max(0, len(found) - count) :]


def _directory(arguments: argparse.Namespace) -> Path:
    """Return the output directory that is meant."""
    if arguments.directory is not None:
        if not (arguments.directory / LOG_FOLDER).is_dir():
            raise NoTrace(
                f"{arguments.directory} is not the output directory of a run: it has no folder {LOG_FOLDER}"
            )
        return Path(arguments.directory)
    if arguments.run is None and not live_runs():
        folders = [path.parent for path in Path("output").glob(f"*/*/{LOG_FOLDER}")]
        if not folders:
            raise NoTrace(
                "no run on this machine, and none in ./output; give DIR, the output directory of a run"
            )
        return max(folders, key=lambda folder: folder.stat().st_mtime)
    record = choose_run(arguments.run).record
    if record is None:
        raise NoTrace("the run is still starting; try again")
    return Path(record.output_directory)


def _is_live(directory: Path) -> bool:
    outputs = [run.record.output_directory for run in live_runs() if run.record]
    return str(directory.absolute()) in outputs


def _print_crashes(directory: Path, arguments: argparse.Namespace) -> None:
    for report in crash_reports(directory, arguments.module, arguments.last):
        if arguments.json:
            print(json.dumps(asdict(report)))
        else:
            print("\n".join(report.lines()), end="\n\n")


class EntryPrinter:
    """Prints entries, in colour on a terminal (unless NO_COLOR is set)."""

    def __init__(self, *, as_json: bool):
        output = console()
        self._as_json = as_json
        self._is_coloured = output.is_terminal and not output.no_color

    def print(self, entry: Entry) -> None:
        """Print one entry, its further lines indented."""
        if self._as_json:
            print(entry.to_line().decode(), end="")
            return
        head = f"{time_of_day(entry.time_s)} {one_line(entry.module)}#{entry.incarnation} "
        logger = f"{entry.logger}: " if entry.logger not in ("", entry.module) else ""
        lines = [f"{entry.kind} {logger}{entry.text}", *entry.traceback.splitlines()]
        text = "\n    ".join(line for part in lines for line in part.split("\n"))
        if self._is_coloured:
            print_styled(head, text, STYLES[entry.kind])
        else:
            print(head + text)


def _kinds(text: str) -> frozenset[Kind]:
    try:
        return frozenset(Kind(word) for word in text.split(",") if word not in ("", "none"))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"expected {', '.join(Kind)}, separated by commas; got {text!r}"
        ) from None
