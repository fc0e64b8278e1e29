"""`robbie stop`: stop a run in order."""

import argparse

from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.run.control import control


def add_parser(subparsers: Commands) -> None:
    """Add `stop` to the commands."""
    parser = add_command(
        subparsers,
        "stop",
        "stop a run in order",
        "Stop a run, its modules in reverse order of their start, and wait until it has ended. "
        "`robbie module stop` stops a single module.",
        ["robbie stop", "robbie stop --run demo"],
    )
    add_run_argument(parser)
    parser.set_defaults(command=stop)


def stop(arguments: argparse.Namespace) -> int:
    """Stop a run."""
    run = choose_run(arguments.run)
    control(run.folder, "stop")
    print(f"run {run.run_id} has ended")
    return 0
