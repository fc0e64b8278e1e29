"""`robbie top` or `robbie-top`: what each process of a run is doing, live or recorded."""

import argparse
import json
import os
import sys
import time
from contextlib import closing

from robbie_mp.attached.views.process_table import modules_table, totals_line
from robbie_mp.attached.views.run_figures import run_as_data
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.utc import time_text
from robbie_mp.bus.observe import RunObserver, RunRates, RunReading, rates_between
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.output import console
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_robot_argument, add_run_argument, choose_run
from robbie_mp.cli.top_csv import record
from robbie_mp.run.run_directory import is_live

SHORTEST_INTERVAL_S = 0.1


class NoTerminalProgram(RobbieError, ImportError):
    """The library for the program on the terminal is not installed.

    Example scenarios:
      - a robot's image was made with only the dependencies that it needs to run
    """


def add_parser(subparsers: Commands) -> None:
    """Add `top` to the commands."""
    parser = add_command(
        subparsers,
        "top",
        "show what each process of a run is doing",
        "Show modules, messages, and the publishers and subscribers of each topic, live on a terminal. The "
        "figures come from shared memory: this costs the robot nothing, and works while the core is down. "
        "The bottom line lists the keys.",
        (
            "robbie top",
            "robbie top --once",
            "robbie top --json | jq '.modules[] | {name, state, rates}'",
            "robbie top --csv run.csv --interval 10",
        ),
    )
    parser.add_argument("--once", action="store_true", help="print the figures once, and exit")
    forms = parser.add_mutually_exclusive_group()
    forms.add_argument(
        "--plain", action="store_true", help="print the figures after each interval, until the run ends"
    )
    forms.add_argument("--json", action="store_true", help="print the figures once as JSON, and exit")
    forms.add_argument(
        "--csv",
        metavar="FILE",
        help="write a line per process and interval until the run ends; -: to standard output",
    )
    parser.add_argument(
        "--interval",
        type=time_between(0),
        default=1.0,
        metavar="TIME",
        help="time between two readings, over which rates are measured (1s); 0 with --once: no rates",
    )
    add_run_argument(parser)
    add_robot_argument(parser)
    parser.set_defaults(command=top)


def top(arguments: argparse.Namespace) -> int:
    """Show a run's figures live, once, or as CSV."""
    if arguments.csv:
        interval_s = max(arguments.interval, SHORTEST_INTERVAL_S)
        return record(choose_run(arguments.run), arguments.csv, interval_s, once=arguments.once)
    if arguments.plain and not arguments.once:
        return show_again_and_again(arguments)
    if arguments.json or arguments.once:
        return show_once(arguments)
    try:
        from robbie_mp.cli.top_program.feed import RunFeed  # noqa: PLC0415
        from robbie_mp.cli.top_program.program import TopProgram  # noqa: PLC0415
    except ImportError as error:
        raise NoTerminalProgram(
            f"robbie top needs the library textual ({error}): `pip install textual`; "
            "`robbie top --once`, --json and --csv work without it"
        ) from error
    if not sys.stdout.isatty():
        raise NoTerminalProgram("robbie top needs a terminal; use --once, --json or --csv FILE")
    os.nice(10)  # drawing takes processor time, and the robot comes first
    with closing(RunFeed(arguments.run)) as feed:
        TopProgram(feed, max(arguments.interval, SHORTEST_INTERVAL_S)).run()
    return 0


def show_once(arguments: argparse.Namespace) -> int:
    """Print a run's figures once."""
    run = choose_run(arguments.run)
    with closing(RunObserver(run.run_id)) as observer:
        reading, rates = _read(observer, arguments.interval)
    if arguments.json:
        print(json.dumps(run_as_data(run, reading, rates), indent=2))
    else:
        _print(reading, rates)
    return 0


def show_again_and_again(arguments: argparse.Namespace) -> int:
    """Print a run's figures after each interval, until the run ends."""
    run = choose_run(arguments.run)
    with closing(RunObserver(run.run_id)) as observer:
        before = observer.read()
        while is_live(run.folder):
            time.sleep(max(arguments.interval, SHORTEST_INTERVAL_S))
            now = observer.read()
            _print(now, rates_between(before, now))
            sys.stdout.flush()
            before = now
    return 0


def _print(reading: RunReading, rates: RunRates | None) -> None:
    out = console()
    out.print(time_text(reading.wall_time_s), totals_line(reading, rates), soft_wrap=True)
    out.print(modules_table(reading, rates))


def _read(observer: RunObserver, interval_s: float) -> tuple[RunReading, RunRates | None]:
    before = observer.read()
    if not interval_s:
        return before, None
    time.sleep(interval_s)
    now = observer.read()
    return now, rates_between(before, now)
