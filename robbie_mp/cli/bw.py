"""`robbie bw TYPE`: how much messages are."""

import argparse
from typing import TYPE_CHECKING

from robbie_mp.cli.echo import add_type_argument
from robbie_mp.cli.parser import add_command
from robbie_mp.cli.rates import Rates, add_rate_arguments, print_rates

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `bw` to the commands."""
    parser = add_command(
        subparsers,
        "bw",
        "print how much memory messages take a second",
        "Print every second how many bytes of a message type were published. This reads the core's counters: "
        "it misses nothing and costs the robot nothing.",
        ["robbie bw Image", "robbie bw PointCloud2 --once --json"],
    )
    add_type_argument(parser)
    add_rate_arguments(parser)
    parser.set_defaults(command=lambda arguments: print_rates(arguments, describe))


def describe(rates: Rates) -> str:
    """Put the bytes a second into words."""
    return (
        f"{rates.bytes_per_s / 1e6:.3f} MB/s, {rates.mean_bytes:.0f} bytes a message "
        f"({rates.messages} in {rates.seconds:.2f} s)"
    )
