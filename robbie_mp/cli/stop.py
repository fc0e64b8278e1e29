"""`robbie stop [MODULE]`: stop a run in order, or one of its modules."""

import argparse
from typing import TYPE_CHECKING

from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.supervisor.control_client import control

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `stop` to the commands."""
    parser = subparsers.add_parser(
        "stop",
        help="stop a run in order, or one of its modules",
        description="Stop a whole run, the last module started first, and wait until it has ended. With a "
        "module, stop that one alone; it stays STOPPED until `robbie restart` starts it again.",
    )
    parser.add_argument("module", nargs="?", help="name of the module; without one, the run is stopped")
    add_run_argument(parser)
    parser.set_defaults(command=stop)


def stop(arguments: argparse.Namespace) -> int:
    """Stop a run or a module."""
    run = choose_run(arguments.run)
    said = control(run.folder, "stop", arguments.module)
    print(said or f"run {run.run_id} has ended")
    return 0
