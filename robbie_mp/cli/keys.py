"""`robbie keys new|trust|list|revoke|check`: who may connect to the link of this robot."""

import argparse
import json
import socket
from pathlib import Path

from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.base.utc import time_text
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.output import console
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.connect.link.handshake import TIMEOUT_S, shake_hands
from robbie_mp.connect.link.keys import VALID_DAYS, Certificate, Keys, KeysError, default_folder

DAY_S = 86_400

MAX_PORT = 65_535


def add_parser(subparsers: Commands) -> None:
    """Add `keys` to the commands."""
    parser = subparsers.add_parser("keys", help="make the keys of this robot, and say whom it trusts")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    new = add_command(
        actions,
        "new",
        "make the keys of this robot",
        "Make the key and the certificate of this robot, for links that are encrypted and accept only robots "
        "that it trusts. Prints the file to give to the other robots.",
        ["robbie keys new robot1", "robbie keys new --replace"],
    )
    new.add_argument("name", nargs="?", help="name of this robot (as before, or the machine's name)")
    new.add_argument(
        "--valid",
        metavar="TIME",
        type=time_between(0),
        default=VALID_DAYS * DAY_S,
        help=f"time until they expire ({VALID_DAYS}d)",
    )
    new.add_argument("--replace", action="store_true", help="forget the keys that this robot has")
    new.set_defaults(command=make)
    trusted = add_command(
        actions,
        "trust",
        "let another robot connect",
        "Let another robot connect. Trust this robot there, too: only two that trust each other connect.",
        ["robbie keys trust laptop.pem"],
    )
    trusted.add_argument("file", metavar="FILE", help="file that `robbie keys new` named on the other robot")
    trusted.set_defaults(command=trust)
    listed = add_command(
        actions,
        "list",
        "list whom this robot trusts",
        "List this robot and those that it trusts, with the fingerprints of their keys.",
        ["robbie keys list", "robbie keys list --json"],
    )
    listed.add_argument("--json", action="store_true", help="print JSON for a program to read")
    listed.set_defaults(command=list_all)
    revoked = add_command(
        actions,
        "revoke",
        "no longer let a robot connect",
        "No longer let a robot connect. Links use this when they start.",
        ["robbie keys revoke laptop"],
    )
    revoked.add_argument("name", help="name of the robot, as `robbie keys list` prints it")
    revoked.set_defaults(command=revoke)
    checked = add_command(
        actions,
        "check",
        "find out why two robots do not connect",
        "Connect to the link of another robot once, and print its name, or which of the two does not trust "
        "the other.",
        ["robbie keys check 192.168.1.7:7447"],
    )
    checked.add_argument("address", metavar="HOST:PORT", help="where the other robot's link listens")
    checked.add_argument(
        "--timeout",
        metavar="TIME",
        type=time_between(0),
        default=TIMEOUT_S,
        help=f"time limit ({TIMEOUT_S:g}s)",
    )
    checked.set_defaults(command=check)
    for action in (new, trusted, listed, revoked, checked):
        action.add_argument(
            "--folder", type=Path, default=default_folder(), help="folder of the keys (%(default)s)"
        )


def make(arguments: argparse.Namespace) -> int:
    """Make keys, and print what to do with them."""
    keys = Keys(arguments.folder)
    made = keys.make(
        arguments.name or _present_name(keys), arguments.valid / DAY_S, replace=arguments.replace
    )
    print(f"made the keys of {made.robot}, which expire on {made.expires:%Y-%m-%d}")
    print(f"fingerprint: {made.fingerprint}")
    print(f"copy {made.file} to each robot that may connect, and there: robbie keys trust {made.file.name}")
    return 0


def _present_name(keys: Keys) -> str:
    try:
        return keys.own().robot
    except KeysError:
        return socket.gethostname().partition(".")[0]


def trust(arguments: argparse.Namespace) -> int:
    """Trust a robot, and print the fingerprint to compare."""
    found = Keys(arguments.folder).trust(Path(arguments.file))
    print(f"{found.robot} may connect from the next start of a link on, until {found.expires:%Y-%m-%d}")
    print(f"fingerprint: {found.fingerprint}")
    print(f"compare it with what `robbie keys list` prints on {found.robot}")
    return 0


def list_all(arguments: argparse.Namespace) -> int:
    """Print all certificates."""
    keys = Keys(arguments.folder)
    own, trusted = keys.own(), keys.trusted()
    if arguments.json:
        print(json.dumps({"own": _plain(own), "trusted": [_plain(one) for one in trusted]}, indent=2))
        return 0
    table = PlainTable()
    for heading in ("robot", "", "expires", "fingerprint"):
        table.add_column(heading)
    for one in (own, *trusted):
        whose = "this robot" if one is own else "trusted"
        table.add_row(one.robot, whose, f"{one.expires:%Y-%m-%d}", one.fingerprint)
    console().print(table)
    return 0


def _plain(one: Certificate) -> dict[str, str]:
    expires = time_text(one.expires.timestamp())
    return {"robot": one.robot, "expires": expires, "fingerprint": one.fingerprint, "file": str(one.file)}


def revoke(arguments: argparse.Namespace) -> int:
    """Trust a robot no longer."""
    Keys(arguments.folder).revoke(arguments.name)
    print(f"{arguments.name} may no longer connect; restart the links that run now")
    return 0


def check(arguments: argparse.Namespace) -> int:
    """Try to connect to another robot."""
    host, _, port = arguments.address.removeprefix("tls/").rpartition(":")
    if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) <= MAX_PORT:
        raise KeysError(f"expected HOST:PORT, such as 192.168.1.7:7447; got {arguments.address!r}")
    name = shake_hands(Keys(arguments.folder), host.strip("[]"), int(port), arguments.timeout)
    print(f"{name} answers at {arguments.address}; it and this robot trust each other")
    return 0
