"""Measures what a link keeps of its promises over a bad network. Needs root.

    python -m tools.link.trial --seconds 20 --json FILE
    python -m tools.link.trial --seconds 6 --engines robbie,link_alone,plain_zenoh,tcp,dds
    python -m tools.link.trial --seconds 10 --engines robbie,router,tls,no_udp --only loss

Two robots run on two hosts of a test network. All the time, bulk messages fill the link, and the laptop sends
commands to the robot. With --engines, modules of `tools.link.engines` exchange the same messages, one after
the other on each network; `router`, `tls` and `no_udp` are links through a router of Zenoh, with keys, and on
a network that carries no UDP. The exit code is 1 if the link has broken a promise.
"""

import argparse
import itertools
import json
import math
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from tools.bench.machine import describe_machine
from tools.bench.table import render
from tools.link.pair import (
    NO_UDP_WAY,
    OURS,
    ROUTER,
    WAYS,
    EngineSide,
    LinkedRobot,
    LinkSide,
    Received,
    settings_of,
    start_router,
    without_udp,
)
from tools.robot import RobotTrouble
from tools.test_network.network import PERFECT, Network, NetworkConditions, NoTestNetwork

PORT = 7447
PERIODS_S = {"urgent": 0.5, "state": 0.1, "reliable": 0.02, "bulk": 0.06}
"""With the size of the bulk messages, about 27 Mbit/s: more than any condition carries."""
COMMAND, COMMAND_PERIOD_S = "command", 0.05

SETTLE_S = 3.0
"""Time from a change of the network until the measurement: the link measures the network first."""
DRAIN_S = 15.0
"""Time limit in which reliable messages arrive that a bad network has held back."""
COMMAND_ALLOWANCE_S = 0.05
STATE_PERIODS = 3
GOOD = NetworkConditions(bandwidth_bit_per_s=20e6, delay_s=0.005)


@dataclass(frozen=True)
class LinkTrial:
    """One condition.

    Attributes:
        title: in plain words.
        conditions: of the network all the time.
        cut_s: time without any network, in the middle.
        flapping_s: times of a network that comes and goes, up and down.
        then: conditions from the middle on.
    """

    title: str
    conditions: NetworkConditions
    cut_s: float = 0.0
    flapping_s: tuple[float, float] | None = None
    then: NetworkConditions | None = None

    @property
    def holds(self) -> bool:
        """Whether the network is there all the time."""
        return not self.cut_s and self.flapping_s is None

    @property
    def round_trip_s(self) -> float:
        """The longest round trip of the network itself."""
        return 2 * (self.conditions.delay_s + self.conditions.jitter_s)


TRIALS = [
    LinkTrial("20 Mbit/s, 5 ms each way", GOOD),
    LinkTrial("2 % loss", NetworkConditions(20e6, loss=0.02, delay_s=0.005)),
    LinkTrial("20 % loss", NetworkConditions(20e6, loss=0.2, delay_s=0.005)),
    LinkTrial("5 Mbit/s", NetworkConditions(5e6, delay_s=0.005)),
    LinkTrial("5 Mbit/s, 50 ms each way", NetworkConditions(5e6, delay_s=0.05)),
    LinkTrial("100 ± 50 ms each way", NetworkConditions(20e6, delay_s=0.1, jitter_s=0.05)),
    LinkTrial("fall from 800 to 5 Mbit/s", NetworkConditions(800e6), then=NetworkConditions(5e6)),
    LinkTrial("10 s without network", GOOD, cut_s=10.0),
    LinkTrial("flapping: 2 s up, 1 s down", GOOD, flapping_s=(2.0, 1.0)),
]


@dataclass
class LinkFigures:
    """The measurements in one condition. Times in ms.

    Attributes:
        failures: promises that were not kept.
        engine: one of `WAYS`, or a module of `tools.link.engines`.
        bulk_p50: time from one robot to the other.
    """

    title: str
    commands_received: float = 0.0
    command_p50: float = math.nan
    command_p99: float = math.nan
    command_max: float = math.nan
    urgent_max: float = math.nan
    state_age_max: float = math.nan
    reliable_p99: float = math.nan
    reliable_missing: int = 0
    bulk_mbit_per_s: float = 0.0
    failures: list[str] = field(default_factory=list)
    engine: str = OURS
    bulk_p50: float = math.nan


@dataclass(frozen=True)
class Pair:
    """The robot and the laptop, and the network between them."""

    robot: LinkSide
    laptop: LinkSide
    network: Network
    engine: str = OURS


@contextmanager
def linked_pair(folder: Path, network: Network, way: str = OURS) -> Iterator[Pair]:
    """Start both in a folder, and wait until they are linked.

    Raises:
        RobotTrouble: they do not start, or do not find each other, or one has ended by itself.
    """
    here, there = network.host("robot"), network.host("laptop")
    ways = settings_of(way, folder, ("robot", "laptop"), here.address, PORT)
    sent = {topic: [f"Probe {topic}"] for topic in PERIODS_S}
    link = {"send": sent, "state_hz": 100.0, "accept": {"laptop": [f"Probe {COMMAND}"]}}
    robot = LinkedRobot(folder, "robot", ways[0] | link, PERIODS_S, [COMMAND], on_host=here.command())
    link = {"send": {"command": [f"Probe {COMMAND}"]}, "accept": {"robot": ["*"]}}
    sends, hears = {COMMAND: COMMAND_PERIOD_S}, list(PERIODS_S)
    laptop = LinkedRobot(folder, "laptop", ways[1] | link, sends, hears, on_host=there.command())
    with ExitStack() as started:
        if way == ROUTER:
            router = start_router(f"tcp/{here.address}:{PORT}", here.command())
            started.callback(router.wait)
            started.callback(router.kill)
        if way == NO_UDP_WAY:
            started.enter_context(without_udp(here, there))
        for one in (robot, laptop):
            one.start()
            started.callback(one.close)
        for one in (robot, laptop):
            one.run.wait_until_running()
        robot.wait_until_heard([COMMAND])
        laptop.wait_until_heard(["state"])
        yield Pair(robot, laptop, network, way)
        for one in (laptop, robot):
            if not one.run.is_up:
                raise RobotTrouble(f"a run has ended by itself: {one.run.said()[-2000:]}")
            one.run.stop()


@contextmanager
def engine_pair(folder: Path, network: Network, engine: str) -> Iterator[Pair]:
    """Start both sides of another engine, and wait until they hear each other.

    Raises:
        RobotTrouble: they do not start, or do not hear each other, or one has ended by itself.
    """
    here, there = network.host("robot"), network.host("laptop")
    with ExitStack() as started:
        sides = []
        for own, other, sends in ((here, there, PERIODS_S), (there, here, {COMMAND: COMMAND_PERIOD_S})):
            sides.append(EngineSide(folder, engine, own, other, sends))
            started.callback(sides[-1].close)
        robot, laptop = sides
        robot.wait_until_heard([COMMAND])
        laptop.wait_until_heard(list(PERIODS_S))
        yield Pair(robot, laptop, network, engine)
        for side in sides:
            side.check()


def run_trial(pair: Pair, trial: LinkTrial, duration_s: float) -> LinkFigures:
    """Set the network, measure, and set it perfect again."""
    pair.network.set(trial.conditions)
    time.sleep(SETTLE_S)
    began_s = time.monotonic()
    with ExitStack() as changes:
        if trial.flapping_s is not None:
            changes.enter_context(pair.network.flapping(*trial.flapping_s))
        if trial.cut_s:
            time.sleep(duration_s / 2)
            pair.network.cut()
            time.sleep(trial.cut_s)
            pair.network.restore()
            time.sleep(duration_s / 2)
        elif trial.then is not None:
            time.sleep(duration_s / 2)
            pair.network.set(trial.then)
            time.sleep(duration_s / 2)
        else:
            time.sleep(duration_s)
    ended_s = time.monotonic()
    pair.network.set(PERFECT)
    _drain(pair, ended_s)
    return _evaluate(pair, trial, began_s, ended_s)


def _drain(pair: Pair, until_s: float) -> None:
    """Wait until the reliable messages that were sent until then have arrived, or for a while."""
    limit_s = time.monotonic() + DRAIN_S
    while time.monotonic() < limit_s:
        received = pair.laptop.received("reliable")
        if received and received[-1].sent_s > until_s:
            return
        time.sleep(0.2)


def _evaluate(pair: Pair, trial: LinkTrial, began_s: float, ended_s: float) -> LinkFigures:
    def sent_within(found: Sequence[Received]) -> list[Received]:
        return [one for one in found if began_s <= one.sent_s < ended_s]

    figures = LinkFigures(trial.title, engine=pair.engine)
    everything = {topic: pair.laptop.received(topic) for topic in PERIODS_S}
    everything[COMMAND] = pair.robot.received(COMMAND)
    for topic, found in everything.items():
        numbers = [one.number for one in found]
        if len(set(numbers)) != len(numbers):
            figures.failures.append(f"{topic}: duplicates")
        if numbers != sorted(numbers):
            figures.failures.append(f"{topic}: reordered")
    within = {topic: sent_within(found) for topic, found in everything.items()}
    commands = [one.latency_s * 1e3 for one in within[COMMAND]]
    sent = [at_s for at_s in pair.laptop.sent(COMMAND).values() if began_s <= at_s < ended_s]
    figures.commands_received = len(commands) / max(1, len(sent))
    if commands:
        figures.command_p50, figures.command_p99 = map(float, np.percentile(commands, [50, 99]))
        figures.command_max = max(commands)
    figures.urgent_max = max((one.latency_s * 1e3 for one in within["urgent"]), default=math.nan)
    figures.state_age_max = _greatest_age_s(everything["state"], began_s, ended_s) * 1e3
    reliable = [one.latency_s * 1e3 for one in within["reliable"]]
    figures.reliable_p99 = float(np.percentile(reliable, 99)) if reliable else math.nan
    expected = {number for number, at_s in pair.robot.sent("reliable").items() if began_s <= at_s < ended_s}
    figures.reliable_missing = len(expected - {one.number for one in within["reliable"]})
    bulk = [one for one in everything["bulk"] if began_s <= one.at_s < ended_s]
    figures.bulk_mbit_per_s = len(bulk) * 200_000 * 8e-6 / (ended_s - began_s)
    if bulk:
        figures.bulk_p50 = float(np.percentile([one.latency_s * 1e3 for one in bulk], 50))
    _judge(figures, trial)
    return figures


def _greatest_age_s(found: Sequence[Received], began_s: float, ended_s: float) -> float:
    """Return the greatest age that the newest message had at any moment."""
    newest = [one for one in found if one.at_s >= began_s - 1.0]
    ages = [
        following.at_s - one.sent_s
        for one, following in pairwise(newest)
        if began_s <= following.at_s < ended_s
    ]
    return max(ages, default=math.nan)


def _judge(figures: LinkFigures, trial: LinkTrial) -> None:
    limit_ms = (trial.round_trip_s + COMMAND_ALLOWANCE_S) * 1e3
    if not figures.command_p99 <= limit_ms:
        figures.failures.append(f"commands: p99 above {limit_ms:.0f} ms")
    if trial.holds and not figures.state_age_max <= STATE_PERIODS * PERIODS_S["state"] * 1e3:
        figures.failures.append(f"state: older than {STATE_PERIODS} periods")
    if figures.reliable_missing:
        figures.failures.append(f"reliable: {figures.reliable_missing} missing")


HEADINGS = (
    "network", "engine", "commands: received", "p50, p99, max ms", "urgent: max ms", "state: greatest age ms",
    "reliable: p99 ms, missing", "bulk: Mbit/s, p50 ms", "broken",
)  # fmt: skip


def row(one: LinkFigures) -> list[str]:
    """Return a row of the table."""
    return [
        one.title,
        one.engine,
        f"{one.commands_received:.1%}",
        f"{one.command_p50:.0f}, {one.command_p99:.0f}, {one.command_max:.0f}",
        f"{one.urgent_max:.0f}",
        f"{one.state_age_max:.0f}",
        f"{one.reliable_p99:.0f}, {one.reliable_missing}",
        f"{one.bulk_mbit_per_s:.1f}, {one.bulk_p50:.0f}",
        "; ".join(one.failures) or "-",
    ]


def _measure(folder: Path, network: Network, trial: LinkTrial, engine: str, duration_s: float) -> LinkFigures:
    """Measure one engine on one network. Each pair is new, so that no row depends on the one before.

    The delay is there before the pair starts: BBR, the congestion control of TCP on many machines, sends for
    10 s as if the round trip were the shortest that it has seen.
    """
    network.delay(trial.conditions)
    started = (linked_pair if engine in WAYS else engine_pair)(folder, network, engine)
    try:
        with started as pair:
            return run_trial(pair, trial, duration_s)
    except RobotTrouble as error:
        return LinkFigures(trial.title, engine=engine, failures=[str(error)])


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.link.trial",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement (20)")
    parser.add_argument(
        "--only", metavar="WORD", default="", help="only conditions whose title has this word"
    )
    parser.add_argument(
        "--engines",
        metavar="NAMES",
        default=OURS,
        help=f"{', '.join(WAYS)}, or others, with commas between ({OURS})",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args()
    trials = [one for one in TRIALS if options.only in one.title]
    found = []
    try:
        with Network("robot", "laptop") as network:
            for trial, engine in itertools.product(trials, options.engines.split(",")):
                with tempfile.TemporaryDirectory(prefix="robbie-link-") as folder:
                    found.append(_measure(Path(folder), network, trial, engine, options.seconds))
                print(found[-1], flush=True)
    except NoTestNetwork as error:
        print(f"not measured: {error}", file=sys.stderr)
        return 2
    print(render(HEADINGS, [row(one) for one in found]))
    if options.json:
        report = {"machine": describe_machine(), "conditions": [asdict(one) for one in found]}
        options.json.write_text(json.dumps(report, indent=2))
    return int(any(one.failures for one in found if one.engine in WAYS))


if __name__ == "__main__":
    sys.exit(main())
