"""`robbie clean`: remove the remains of dead runs."""

import argparse
import json
from dataclasses import asdict
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
        ["robbie clean", "robbie clean --json"],
    )
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=clean)


def clean(arguments: argparse.Namespace) -> int:
    """Remove the remains, and print what was removed."""
    swept = sweep()
    if arguments.json:
        print(json.dumps(asdict(swept), indent=2))
        return 0
    print(
        f"removed {len(swept.runs)} dead runs, {len(swept.names)} names in shared memory, "
        f"{len(swept.processes)} processes"
    )
    return 0
