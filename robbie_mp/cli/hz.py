"""`robbie hz TYPE|TOPIC`: the rate of messages."""

from robbie_mp.attached.views import quantities
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.rates import TrafficRates, TrafficSummary, add_rate_arguments, print_rates


def add_parser(subparsers: Commands) -> None:
    """Add `hz` to the commands."""
    parser = add_command(
        subparsers,
        "hz",
        "print the rate of messages",
        "Print every second how many messages of a type, or on a topic, were published, and how regularly. "
        "At Ctrl-C it sums up. The figures come from the core's counters: they miss no message and cost the "
        "robot nothing.",
        [
            "robbie hz LaserScan",
            "robbie hz laser/front",
            "robbie hz Odometry --topic wheels --interval 10s --once --json",
        ],
    )
    add_rate_arguments(parser)
    parser.set_defaults(command=lambda arguments: print_rates(arguments, describe, summarize))


def describe(rates: TrafficRates) -> str:
    """Describe the rate of messages in one line."""
    return f"{rates.hz:.4g} Hz{_regularity(rates)} ({rates.messages} in {rates.seconds:.2f} s)"


def summarize(summary: TrafficSummary) -> str:
    """Sum up the rate of messages in one line."""
    rate = summary.spread(lambda rates: rates.hz)
    return (
        f"mean {rate.mean:.4g} Hz, min {rate.least:.4g} Hz, max {rate.greatest:.4g} Hz, "
        f"deviation {rate.deviation:.2g} Hz{_regularity(summary.total)} ({summary.total.messages} messages)"
    )


def _regularity(rates: TrafficRates) -> str:
    if rates.interval_mean_s is None or rates.interval_deviation_s is None:
        return ""
    return f", every {quantities.interval(rates.interval_mean_s, rates.interval_deviation_s)}"
