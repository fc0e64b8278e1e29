"""The rates of messages and bytes that `hz` and `bw` print, from the core's counters."""

import argparse
import json
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from statistics import pstdev
from typing import NamedTuple

from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe.rates import intervals_deviation_s
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.channels import ChannelCounters
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.tables import ChannelCounts, ChannelName
from robbie_mp.cli.amounts import time_between
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
        "--interval",
        metavar="TIME",
        type=time_between(0.01, 1e6),
        default=1.0,
        help="time that each line covers (1s)",
    )
    parser.add_argument("--once", action="store_true", help="print once, and exit")
    parser.add_argument("--json", action="store_true", help="print each line as JSON")
    add_run_argument(parser)


class Spread(NamedTuple):
    """How a rate varied."""

    mean: float
    least: float
    greatest: float
    deviation: float


@dataclass(frozen=True)
class TrafficSummary:
    """The traffic of a channel over the whole measurement."""

    total: TrafficRates
    lines: list[TrafficRates]
    """What was printed of it, one for each interval."""

    def spread(self, of: Callable[[TrafficRates], float]) -> Spread:
        """Return the mean over the whole time, and least, greatest and deviation of the lines."""
        values = [of(line) for line in self.lines]
        return Spread(of(self.total), min(values), max(values), pstdev(values))


def print_rates(
    arguments: argparse.Namespace,
    describe: Callable[[TrafficRates], str],
    summarize: Callable[[TrafficSummary], str],
) -> int:
    """Print a line for each topic periodically until the run ends or the user presses Ctrl-C; then sum up.

    Args:
        arguments: those of `add_rate_arguments`.
        describe: returns the text for the rates of a topic in an interval.
        summarize: returns the text that sums up the rates of a topic.
    """
    run = choose_run(arguments.run)
    wanted = choose_messages(run, arguments).channel
    with closing(Segment.attach(names.core(run.run_id), SegmentKind.CORE)) as segment:
        counters = ChannelCounters(segment.words)
        meter = RateMeter(counters, wanted)
        try:
            while True:
                time.sleep(arguments.interval)
                rates = meter.measure()
                for rate in rates:
                    _print(rate.topic, asdict(rate), describe(rate), arguments)
                if not rates:
                    print(one_line(nobody_publishes(wanted, counters.messages())), flush=True)
                if arguments.once:
                    return 0
                if not run.folder.exists():
                    break
        except KeyboardInterrupt:
            _print_summary(meter, summarize, arguments)
            raise
        _print_summary(meter, summarize, arguments)
    return 0


def _print_summary(
    meter: "RateMeter", summarize: Callable[[TrafficSummary], str], arguments: argparse.Namespace
) -> None:
    """Sum up each topic; a single line needs no summary."""
    summaries = [one for one in meter.summaries() if len(one.lines) > 1]
    if summaries and not arguments.json:
        print(f"--- in {meter.seconds:.1f} s:")
    for one in summaries:
        spread = {name: one.spread(of)._asdict() for name, of in SPREAD_OF.items()}
        _print(one.total.topic, {"summary": True, **asdict(one.total), **spread}, summarize(one), arguments)


def _print(topic: str, data: dict[str, object], text: str, arguments: argparse.Namespace) -> None:
    about = f"  topic {one_line(topic)}" if topic else ""
    print(json.dumps(data) if arguments.json else text + about, flush=True)


class RateMeter:
    """Compares readings of the core's counters.

    Args:
        counters: the counters.
        wanted: the channel; topic '' for all topics.
    """

    def __init__(self, counters: ChannelCounters, wanted: ChannelName):
        self._counters, self._wanted = counters, wanted
        self._first = self._before = _Reading.take(counters, wanted)
        self._lines: dict[str, list[TrafficRates]] = {}

    def measure(self) -> list[TrafficRates]:
        """Return the rates of each topic since the last call."""
        before, self._before = self._before, _Reading.take(self._counters, self._wanted)
        rates = self._before.since(before)
        for rate in rates:
            self._lines.setdefault(rate.topic, []).append(rate)
        return rates

    @property
    def seconds(self) -> float:
        """The time from the first to the last reading."""
        return self._before.at_s - self._first.at_s

    def summaries(self) -> list[TrafficSummary]:
        """Return what was measured of each topic, from the first to the last reading."""
        totals = self._before.since(self._first)
        return [TrafficSummary(total, self._lines[total.topic]) for total in totals if self._lines]


class _Reading(NamedTuple):
    counts: dict[str, ChannelCounts]
    at_s: float

    @classmethod
    def take(cls, counters: ChannelCounters, wanted: ChannelName) -> "_Reading":
        return cls(counters.read(*wanted), time.monotonic())

    def since(self, before: "_Reading") -> list[TrafficRates]:
        return [
            TrafficRates.between(
                topic, before.counts.get(topic, ChannelCounts()), count, self.at_s - before.at_s
            )
            for topic, count in sorted(self.counts.items())
        ]


SPREAD_OF: dict[str, Callable[[TrafficRates], float]] = {
    "hz": lambda rates: rates.hz,
    "bytes_per_s": lambda rates: rates.bytes_per_s,
}
"""What varies from line to line, by its name in the summary as JSON."""
