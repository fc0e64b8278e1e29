"""`robbie bw TYPE|TOPIC`: the bandwidth of messages."""

from robbie_mp.attached.views.quantities import decimal_size
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.rates import TrafficRates, TrafficSummary, add_rate_arguments, print_rates


def add_parser(subparsers: Commands) -> None:
    """Add `bw` to the commands."""
    parser = add_command(
        subparsers,
        "bw",
        "print the bandwidth of messages",
        "Print every second how many bytes of a message type, or on a topic, were published. At Ctrl-C "
        "it sums up. The figures come from the core's counters: they miss no message and cost the robot "
        "nothing.",
        ["robbie bw Image", "robbie bw front/camera", "robbie bw PointCloud2 --once --json"],
    )
    add_rate_arguments(parser)
    parser.set_defaults(command=lambda arguments: print_rates(arguments, describe, summarize))


def describe(rates: TrafficRates) -> str:
    """Describe the bandwidth in one line."""
    return (
        f"{decimal_size(rates.bytes_per_s)}/s, {decimal_size(rates.mean_bytes)} a message "
        f"({rates.messages} in {rates.seconds:.2f} s)"
    )


def summarize(summary: TrafficSummary) -> str:
    """Sum up the bandwidth in one line."""
    mean, least, greatest, deviation = map(decimal_size, summary.spread(lambda rates: rates.bytes_per_s))
    return (
        f"mean {mean}/s, min {least}/s, max {greatest}/s, deviation {deviation}/s, "
        f"{decimal_size(summary.total.mean_bytes)} a message ({summary.total.messages} messages)"
    )
