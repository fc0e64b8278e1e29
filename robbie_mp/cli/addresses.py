"""The option for the addresses of robots on a network."""

import argparse

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


def addresses_of(arguments: argparse.Namespace) -> list[str]:
    """Return the addresses that were given, or the default."""
    given: list[str] = arguments.addresses or [DEFAULT_ADDRESS]
    return given
