"""`robbie module start|stop|restart NAME`: start and stop single modules of a run."""

import argparse
from typing import TYPE_CHECKING

from robbie_mp.cli import completers
from robbie_mp.cli.parser import add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.run.control import control

if TYPE_CHECKING:
    from argparse import _SubParsersAction

DESCRIPTIONS = {
    "restart": "Stop a module in order if it runs, start it again with its full restart budget, and wait "
    "until it is RUNNING. The module may also be FAILED or STOPPED. Modules that depend on it restart with "
    "it. Exit code 0: it is RUNNING; 1: it is not.",
    "stop": "Stop a module in order, and wait until it has ended. It stays STOPPED until you start it.",
    "start": "Start a module that is STOPPED or FAILED with its full restart budget, and wait until it is "
    "RUNNING. Exit code 0: it is RUNNING; 1: it is not.",
}


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `module` to the commands."""
    parser = subparsers.add_parser("module", help="start, stop or restart one module of a run")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    for action, description in DESCRIPTIONS.items():
        command = add_command(
            actions, action, f"{action} one module", description, [f"robbie module {action} laser"]
        )
        name = command.add_argument("module", help="name of the module" + ", or core" * (action == "restart"))
        name.completer = completers.modules  # type: ignore[attr-defined]
        add_run_argument(command)
        command.set_defaults(command=tell, action=action)


def tell(arguments: argparse.Namespace) -> int:
    """Send the supervisor a command for a module."""
    print(control(choose_run(arguments.run).folder, arguments.action, arguments.module))
    return 0
