"""`robbie report [RUN]`: one HTML file about a run, which needs no network."""

import argparse
from pathlib import Path

from robbie_mp.attached.views import quantities
from robbie_mp.base.linux.private_files import write_private
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli.log_files import progress_bar
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.report import choose_results, read_run, report_of
from robbie_mp.logs.report.report import REPORT_FILE
from robbie_mp.logs.report.run_files import OUTPUT


def add_parser(subparsers: Commands) -> None:
    """Add `report` to the commands."""
    parser = add_command(
        subparsers,
        "report",
        "make one HTML file about a run",
        "Make a report of a run: map, path, what was found, what failed and how long until it recovered, "
        "what became of all messages, battery, processors, marks and stops. It is one file, which needs no "
        "network. The run may still run, have ended, or have been killed. Messages are read from its "
        "recording, or, without one, from the clips of its black box.",
        [
            "robbie report",
            "robbie report rescue",
            "robbie report output/rescue/20261129T032700Z-4711 --output monday.html",
        ],
    )
    parser.add_argument(
        "run",
        nargs="?",
        metavar="RUN",
        help="a run, by its folder for results, its id, or its profile, whose newest run is meant; default: "
        "the run of this workspace, otherwise the newest one",
    )
    parser.add_argument(
        "--in", dest="folder", type=Path, metavar="DIR", default=OUTPUT, help="folder with results (output)"
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help=f"file to write ({REPORT_FILE} in the results of the run)"
    )
    parser.set_defaults(command=report)


def report(arguments: argparse.Namespace) -> int:
    """Write the report."""
    folder, known = choose_results(arguments.run, arguments.folder)
    with progress_bar("reading the run") as progress:
        made = report_of(read_run(folder, known), progress).encode()
    path = arguments.output or folder / REPORT_FILE
    write_private(path, made)
    print(f"{one_line(str(path))} ({quantities.size(len(made))})")
    return 0
