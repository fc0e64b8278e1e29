"""`robbie connect ROBOT`: a run on this machine that sees and steers a robot elsewhere."""

import argparse
import json
import re
import socket

from robbie_mp.base.problem import refuse
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.cli.addresses import add_address_argument, addresses_of, endpoints_of
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.profile import add_set_argument, load
from robbie_mp.cli.run import add_output_arguments, check, run_robot
from robbie_mp.connect.link.header import ROBOT_NAME
from robbie_mp.connect.link.wire import find_robots

PROFILE = "robbie:operator"
LINK = "link"
MAX_NAME = 32


def add_parser(subparsers: Commands) -> None:
    """Add `connect` to the commands."""
    parser = add_command(
        subparsers,
        "connect",
        "see and steer a robot on another machine",
        "Start a run on this machine with a link to a robot. What the robot sends can be seen here as if it "
        "ran here: on the operator's page, and by `robbie top`, `echo` and `record`. The robot's profile "
        "decides what it sends, and what it accepts from here. `robbie param`, `call`, `log` and `top` with "
        "--robot work on the robot itself.",
        [
            "robbie connect red --at tcp/192.168.0.7:7447",
            "robbie connect red --at tls/red.local:7447 --keys ~/.config/robbie/keys --as laptop",
        ],
    )
    parser.add_argument("robot", help="name of the robot, as in the setting `robot` of its link")
    add_address_argument(parser)
    parser.add_argument(
        "--as", dest="own_name", metavar="NAME", default=own_name(), help="name of this side (%(default)s)"
    )
    add_set_argument(parser)
    add_output_arguments(parser)
    parser.set_defaults(command=connect, profile=PROFILE)


def own_name() -> str:
    """Return the name of this machine, as far as a robot can be called so."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", socket.gethostname()).strip("-_")
    return name[:MAX_NAME] or "operator"


def connect(arguments: argparse.Namespace) -> int:
    """Run the operator's side of a link until Ctrl-C."""
    addresses = addresses_of(arguments)
    for name in (arguments.robot, arguments.own_name):
        if not ROBOT_NAME.fullmatch(name):
            raise refuse(f"a robot cannot be called {name!r}: up to {MAX_NAME} letters, digits, - and _")
    if arguments.robot == arguments.own_name:
        raise refuse(f"both sides are called {arguments.robot}; name this one with --as")
    found = find_robots(endpoints_of(arguments))
    if arguments.robot not in found:
        near = did_you_mean(arguments.robot, found)
        known = f"; robots there: {', '.join(found)}" if found else ", nor any other robot"
        warn(f"{arguments.robot} is not at {', '.join(addresses)} now{near or known}; waiting for it")
    settings: dict[str, object] = {
        "robot": arguments.own_name,
        "connect": addresses,
        "robots": [arguments.robot],
        "accept": {arguments.robot: ["*"]},
    }
    if arguments.keys is not None:
        settings["keys"] = str(arguments.keys.absolute())
    given = [f"{LINK}.{name}={json.dumps(value)}" for name, value in settings.items()]
    profile, findings = check(load(arguments, given))
    return run_robot(profile, findings, arguments)
