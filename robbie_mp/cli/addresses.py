"""The options for the addresses of robots on a network, and for the keys of encrypted ones."""

import argparse
from pathlib import Path

from robbie_mp.base.problem import refuse
from robbie_mp.connect.link.keys import Keys, KeysError
from robbie_mp.connect.link.wire import Endpoints

DEFAULT_ADDRESS = "tcp/127.0.0.1:7447"


def add_address_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option for the addresses of robots or of a router: `addresses`."""
    parser.add_argument(
        "--at",
        dest="addresses",
        metavar="ADDRESS",
        action="append",
        help=f"address of a robot or a router of Zenoh; may be repeated ({DEFAULT_ADDRESS})",
    )
    parser.add_argument(
        "--keys", type=Path, metavar="FOLDER", help="folder of the keys of `robbie keys`, for tls/ addresses"
    )


def endpoints_of(arguments: argparse.Namespace) -> Endpoints:
    """Return how the robots are reached that were named by `add_address_argument`."""
    addresses = addresses_of(arguments)
    if arguments.keys is None:
        encrypted = [one for one in addresses if one.startswith(("tls/", "quic/"))]
        if encrypted:
            raise refuse(
                f"{encrypted[0]} needs keys: make them with `robbie keys new`, and name their --keys"
            )
        return Endpoints(connect=addresses)
    open_ones = [one for one in addresses if not one.startswith(("tls/", "quic/"))]
    if open_ones:
        raise refuse(
            f"{open_ones[0]} is not encrypted; with --keys, write tls/{open_ones[0].partition('/')[2]}"
        )
    try:
        return Endpoints(connect=addresses, further=Keys(arguments.keys).zenoh_settings())
    except KeysError as error:
        raise refuse(str(error)) from error


def addresses_of(arguments: argparse.Namespace) -> list[str]:
    """Return the addresses that were given, or the default."""
    given: list[str] = arguments.addresses or [DEFAULT_ADDRESS]
    return given
