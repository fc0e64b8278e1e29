"""`robbie restart MODULE`: restart one module of a run."""

import argparse
from typing import TYPE_CHECKING

from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.supervisor.control_client import control

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `restart` to the commands."""
    parser = subparsers.add_parser(
        "restart",
        help="restart one module of a run",
        description="Stop a module in order if it runs, start it with all of its restarts to spend, and wait "
        "until it is RUNNING. Modules that depend on it are restarted with it. It may be FAILED or STOPPED. "
        "Exit code 0: it is RUNNING; 1: it is not.",
    )
    parser.add_argument("module", help="name of the module, or core")
    add_run_argument(parser)
    parser.set_defaults(command=restart)


def restart(arguments: argparse.Namespace) -> int:
    """Restart a module."""
    print(control(choose_run(arguments.run).folder, "restart", arguments.module))
    return 0
