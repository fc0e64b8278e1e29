"""`robbie clean`: remove what dead runs left."""

import argparse
from typing import TYPE_CHECKING

from robbie_mp.cli.parser import add_command
from robbie_mp.supervisor.sweep import sweep

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `clean` to the commands."""
    parser = add_command(
        subparsers,
        "clean",
        "remove what dead runs left",
        "Remove shared memory, processes and folders of runs whose supervisor is dead. Every "
        "`robbie run` does this first; live runs are not touched.",
        ["robbie clean"],
    )
    parser.set_defaults(command=clean)


def clean(_arguments: argparse.Namespace) -> int:
    """Sweep, and say what was found."""
    swept = sweep()
    print(
        f"removed {len(swept.runs)} dead runs, {len(swept.names)} names in shared memory, "
        f"{len(swept.processes)} processes"
    )
    return 0
