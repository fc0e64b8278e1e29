"""`robbie type show NAME`, `list` and `import`: message types and their fields."""

import argparse
import json
import sys
from pathlib import Path

from robbie_mp.attached.views.known_types import types_of_run_or_workspace
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli import completers
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument


def add_parser(subparsers: Commands) -> None:
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
    imported = add_command(
        actions,
        "import",
        "write the message classes of a package of ROS 2",
        "Write a Python file with the messages, services and actions of a package of ROS 2: a folder with "
        "msg, srv or action in it, a package of the ROS that is installed (AMENT_PREFIX_PATH), or what a log "
        "has that Robbie-MP does not. The stock types are imported. Exit code 1: something was left out.",
        ["robbie type import nav2_msgs --output modules/nav2_msgs.py", "robbie type import run.mcap"],
    )
    imported.add_argument("source", metavar="PACKAGE", help="a folder, the name of a package, or a log")
    imported.add_argument("--output", metavar="FILE", type=Path, help="a new file; without it, print it")
    imported.set_defaults(command=import_types)
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


def import_types(arguments: argparse.Namespace) -> int:
    """Write the classes of a package."""
    from robbie_mp.connect.ros2.interfaces import python_source  # noqa: PLC0415 - reads logs, too

    text, made = python_source(arguments.source)
    for one in made.left_out:
        print(f"left out: {one_line(one)}", file=sys.stderr)
    if arguments.output is None:
        print(text, end="")
    else:
        with arguments.output.open("x", encoding="utf-8") as file:
            file.write(text)
        print(f"{arguments.output}: {len(made.made)} classes")
    return 1 if made.left_out else 0
