"""`robbie clean`: remove the remains of dead runs."""

import argparse
from typing import TYPE_CHECKING

from robbie_mp.cli.parser import add_command
from robbie_mp.run.supervisor.sweep import sweep

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `clean` to the commands."""
    parser = add_command(
        subparsers,
        "clean",
        "remove the remains of dead runs",
        "Remove the shared memory, processes and folders of runs whose supervisor is dead. Each `robbie run` "
        "does this first. Live runs are not touched.",
        ["robbie clean"],
    )
    parser.set_defaults(command=clean)


def clean(_arguments: argparse.Namespace) -> int:
    """Remove the remains, and print what was removed."""
    swept = sweep()
    print(
        f"removed {len(swept.runs)} dead runs, {len(swept.names)} names in shared memory, "
        f"{len(swept.processes)} processes"
    )
    return 0
