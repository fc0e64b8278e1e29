"""`robbie hz TYPE|TOPIC`: the rate of messages."""

import argparse
from typing import TYPE_CHECKING

from robbie_mp.cli.parser import add_command
from robbie_mp.cli.rates import TrafficRates, add_rate_arguments, print_rates

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `hz` to the commands."""
    parser = add_command(
        subparsers,
        "hz",
        "print the rate of messages",
        "Print every second how many messages of a type, or on a topic, were published, and how regularly. "
        "The figures come from the core's counters: they miss no message and cost the robot nothing.",
        [
            "robbie hz LaserScan",
            "robbie hz laser/front",
            "robbie hz Odometry --topic wheels --every 10 --once --json",
        ],
    )
    add_rate_arguments(parser)
    parser.set_defaults(command=lambda arguments: print_rates(arguments, describe))


def describe(rates: TrafficRates) -> str:
    """Describe the rate of messages in one line."""
    line = f"{rates.hz:.2f} Hz"
    if rates.interval_mean_s is not None and rates.interval_deviation_s is not None:
        line += f", every {rates.interval_mean_s * 1e3:.3f} ms ± {rates.interval_deviation_s * 1e3:.3f} ms"
    return f"{line} ({rates.messages} in {rates.seconds:.2f} s)"
