"""`robbie foxglove`: the link that shows a run in Foxglove, and a layout to begin with."""

import argparse
import json
from importlib.resources import files
from pathlib import Path

from robbie_mp.base.problem import refuse
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.run.operator_link import FOXGLOVE_LINK_FILE, read_link

LAYOUT = "layout.json"


def add_parser(subparsers: Commands) -> None:
    """Add `foxglove` to the commands."""
    parser = add_command(
        subparsers,
        "foxglove",
        "print the link that shows a run in Foxglove",
        "Print the link of a run whose profile has a Foxglove server (parent robbie:foxglove). In Foxglove, "
        'choose "Open connection", "Foxglove WebSocket", and paste the link. It contains the token, so '
        "who has it can read the robot's messages, and send what the profile accepts.",
        ["robbie foxglove", "robbie foxglove --run demo", "robbie foxglove --layout robbie.json"],
    )
    add_run_argument(parser)
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.add_argument(
        "--layout",
        metavar="FILE",
        type=Path,
        help='only write a layout, for "Import from file" in Foxglove; needs no run',
    )
    parser.set_defaults(command=foxglove)


def foxglove(arguments: argparse.Namespace) -> int:
    """Print the link, or write the layout."""
    if arguments.layout is not None:
        return _write_layout(arguments.layout)
    link = read_link(choose_run(arguments.run).folder, FOXGLOVE_LINK_FILE)
    if not link:
        raise refuse("this run has no Foxglove server; add the parent `robbie:foxglove` to its profile")
    print(json.dumps({"link": link}) if arguments.json else link)
    return 0


def _write_layout(path: Path) -> int:
    text = files("robbie_mp.connect.foxglove").joinpath(LAYOUT).read_text()
    try:
        with path.open("x") as file:
            file.write(text)
    except OSError as error:
        raise refuse(f"{path} cannot be written: {error.strerror}") from error
    print(f"{path}: import it in Foxglove by Layout, Import from file")
    return 0
