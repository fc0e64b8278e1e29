"""`robbie type show NAME` and `robbie type list`: message types and their fields."""

import argparse
import json
from typing import TYPE_CHECKING

from robbie_mp.attached.views.known_types import types_of_run_or_workspace
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli import completers
from robbie_mp.cli.parser import add_command
from robbie_mp.cli.runs import add_run_argument

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `type` to the commands."""
    parser = subparsers.add_parser("type", help="show message types and their fields")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    shown = add_command(
        actions,
        "show",
        "print the definition of a message type",
        "Print the fields of a message type, and of the types nested in it, in ROS 2's notation. The known "
        "types are the stock types and those of the run; without a run, those of the current workspace.",
        ["robbie type show LaserScan", "robbie type show sensor_msgs/LaserScan --json"],
    )
    name = shown.add_argument(
        "type", metavar="TYPE", help="message type: sensor_msgs/msg/LaserScan, or LaserScan for short"
    )
    name.completer = completers.types  # type: ignore[attr-defined]
    shown.set_defaults(command=show)
    listed = add_command(
        actions,
        "list",
        "list the known message types",
        "List the known message types: the stock types and those of the run or workspace.",
        ["robbie type list"],
    )
    listed.set_defaults(command=list_types)
    for action in (shown, listed):
        add_run_argument(action)
        action.add_argument("--json", action="store_true", help="print JSON for a program to read")


def show(arguments: argparse.Namespace) -> int:
    """Print one type."""
    description = types_of_run_or_workspace(arguments.run).describe(arguments.type)
    if arguments.json:
        print(json.dumps(description._asdict(), indent=2))
    else:
        print(f"# {description.name}, version {description.version}")
        print(description.schema.rstrip("\n"))
    return 0


def list_types(arguments: argparse.Namespace) -> int:
    """Print the names of all types."""
    names = types_of_run_or_workspace(arguments.run).names()
    print(json.dumps(names, indent=2) if arguments.json else "\n".join(map(one_line, names)))
    return 0
