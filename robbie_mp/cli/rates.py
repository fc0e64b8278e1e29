"""The rates of messages and bytes that `hz` and `bw` print, from the core's counters."""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass

from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe.channels import ChannelCounters
from robbie_mp.bus.observe.rates import intervals_deviation_s
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.tables import ChannelCounts, ChannelName
from robbie_mp.cli.channel_choice import add_messages_argument, choose_messages, nobody_publishes
from robbie_mp.cli.runs import add_run_argument, choose_run


@dataclass(frozen=True)
class TrafficRates:
    """The traffic of a channel between two readings."""

    topic: str
    messages: int
    seconds: float
    hz: float
    bytes_per_s: float
    mean_bytes: float
    interval_mean_s: float | None
    """Time from one message to the next, as they were published; None if there were less than two."""
    interval_deviation_s: float | None
    """Its standard deviation."""

    @classmethod
    def between(
        cls, topic: str, before: ChannelCounts, after: ChannelCounts, seconds: float
    ) -> "TrafficRates":
        """Calculate the rates between two readings of the counters."""
        messages, size = after.messages - before.messages, after.bytes - before.bytes
        mean_s = deviation_s = None
        if messages and before.last_ns:
            mean_s = (after.last_ns - before.last_ns) / messages / 1e9
            squares_us2 = after.intervals_squared - before.intervals_squared
            deviation_s = intervals_deviation_s(before.last_ns, after.last_ns, messages, squares_us2)
        return cls(
            topic=topic,
            messages=messages,
            seconds=seconds,
            hz=messages / seconds,
            bytes_per_s=size / seconds,
            mean_bytes=size / messages if messages else 0.0,
            interval_mean_s=mean_s,
            interval_deviation_s=deviation_s,
        )


def add_rate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of both commands."""
    add_messages_argument(parser, "with TYPE: only messages on this topic")
    parser.add_argument(
        "--every", metavar="SECONDS", type=_seconds, default=1.0, help="time that each line covers (1)"
    )
    parser.add_argument("--once", action="store_true", help="print once, and exit")
    parser.add_argument("--json", action="store_true", help="print each line as JSON")
    add_run_argument(parser)


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 0.01 <= seconds <= 1e6:
        raise argparse.ArgumentTypeError(f"expected 0.01 to 1000000 s; got {text}")
    return seconds


def print_rates(arguments: argparse.Namespace, describe: Callable[[TrafficRates], str]) -> int:
    """Print a line for each topic periodically, until the run ends or the user presses Ctrl-C."""
    run = choose_run(arguments.run)
    wanted = choose_messages(run, arguments).channel
    with closing(Segment.attach(names.core(run.run_id), SegmentKind.CORE)) as segment:
        counters = ChannelCounters(segment.words)
        for rates in _measure(counters, wanted, arguments.every):
            for rate in rates:
                about = f"  topic {one_line(rate.topic)}" if rate.topic else ""
                print(json.dumps(asdict(rate)) if arguments.json else describe(rate) + about, flush=True)
            if not rates:
                print(one_line(nobody_publishes(wanted, counters.messages())), flush=True)
            if arguments.once or not run.folder.exists():
                return 0
    return 0


def _measure(counters: ChannelCounters, wanted: ChannelName, every_s: float) -> Iterator[list[TrafficRates]]:
    before, before_s = counters.read(*wanted), time.monotonic()
    while True:
        time.sleep(every_s)
        after, after_s = counters.read(*wanted), time.monotonic()
        yield [
            TrafficRates.between(topic, before.get(topic, ChannelCounts()), count, after_s - before_s)
            for topic, count in sorted(after.items())
        ]
        before, before_s = after, after_s
