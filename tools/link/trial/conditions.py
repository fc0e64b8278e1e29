"""The conditions of the network in a trial, and what is measured in each."""

import math
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from tools.link.trial.pair import PERIODS_S, SEEN_S, Pair, Received
from tools.test_network.network import PERFECT, Conditions

SETTLE_S = 3.0
"""Time from a change of the network until the measurement: the link measures the network first."""
DRAIN_S = 15.0
"""Time limit in which reliable messages arrive that a bad network has held back."""
COMMAND_ALLOWANCE_S = 0.05
STATE_PERIODS = 3
CUT_S = 1.0
"""Time for which the network is cut."""
LINKED_S = 0.5
"""Time for which the base is watched after the link has returned."""
GOOD = Conditions(bandwidth_bit_per_s=20e6, delay_s=0.005)


@dataclass(frozen=True)
class Trial:
    """One condition.

    Attributes:
        title: in plain words.
        conditions: of the network all the time.
        cut_s: time without any network, in the middle.
        flapping_s: times of a network that comes and goes, up and down.
        then: conditions from the middle on.
    """

    title: str
    conditions: Conditions
    cut_s: float = 0.0
    flapping_s: tuple[float, float] | None = None
    then: Conditions | None = None

    @property
    def holds(self) -> bool:
        """Whether the network is there all the time."""
        return not self.cut_s and self.flapping_s is None

    @property
    def round_trip_s(self) -> float:
        """The longest round trip of the network itself."""
        return 2 * (self.conditions.delay_s + self.conditions.jitter_s)


TRIALS = [
    Trial("20 Mbit/s, 5 ms each way", GOOD),
    Trial("2 % loss", Conditions(20e6, loss=0.02, delay_s=0.005)),
    Trial("20 % loss", Conditions(20e6, loss=0.2, delay_s=0.005)),
    Trial("5 Mbit/s", Conditions(5e6, delay_s=0.005)),
    Trial("5 Mbit/s, 50 ms each way", Conditions(5e6, delay_s=0.05)),
    Trial("100 ± 50 ms each way", Conditions(20e6, delay_s=0.1, jitter_s=0.05)),
    Trial("fall from 800 to 5 Mbit/s", Conditions(800e6), then=Conditions(5e6)),
    Trial("10 s without network", GOOD, cut_s=10.0),
    Trial("flapping: 2 s up, 1 s down", GOOD, flapping_s=(2.0, 1.0)),
]


@dataclass
class Figures:
    """The measurements in one condition. Times in ms.

    Attributes:
        failures: promises that were not kept.
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


def run_trial(pair: Pair, trial: Trial, duration_s: float) -> Figures:
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
        received = pair.received("reliable")
        if received and received[-1].sent_s > until_s:
            return
        time.sleep(0.2)


def _evaluate(pair: Pair, trial: Trial, began_s: float, ended_s: float) -> Figures:
    def sent_within(found: Sequence[Received]) -> list[Received]:
        return [one for one in found if began_s <= one.sent_s < ended_s]

    figures = Figures(trial.title)
    everything = {topic: pair.received(topic) for topic in ("manual", *PERIODS_S)}
    for topic, found in everything.items():
        numbers = [one.number for one in found]
        if len(set(numbers)) != len(numbers):
            figures.failures.append(f"{topic}: duplicates")
        if numbers != sorted(numbers):
            figures.failures.append(f"{topic}: reordered")
    within = {topic: sent_within(found) for topic, found in everything.items()}
    commands = [one.latency_s * 1e3 for one in within["manual"]]
    sent = [at_s for at_s in pair.sent("manual").values() if began_s <= at_s < ended_s]
    figures.commands_received = len(commands) / max(1, len(sent))
    if commands:
        figures.command_p50, figures.command_p99 = map(float, np.percentile(commands, [50, 99]))
        figures.command_max = max(commands)
    figures.urgent_max = max((one.latency_s * 1e3 for one in within["urgent"]), default=math.nan)
    figures.state_age_max = _greatest_age_s(everything["state"], began_s, ended_s) * 1e3
    reliable = [one.latency_s * 1e3 for one in within["reliable"]]
    figures.reliable_p99 = float(np.percentile(reliable, 99)) if reliable else math.nan
    expected = {number for number, at_s in pair.sent("reliable").items() if began_s <= at_s < ended_s}
    figures.reliable_missing = len(expected - {one.number for one in within["reliable"]})
    bulk = [one for one in everything["bulk"] if began_s <= one.at_s < ended_s]
    figures.bulk_mbit_per_s = len(bulk) * 200_000 * 8e-6 / (ended_s - began_s)
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


def _judge(figures: Figures, trial: Trial) -> None:
    limit_ms = (trial.round_trip_s + COMMAND_ALLOWANCE_S) * 1e3
    if not figures.command_p99 <= limit_ms:
        figures.failures.append(f"commands: p99 above {limit_ms:.0f} ms")
    if trial.holds and not figures.state_age_max <= STATE_PERIODS * PERIODS_S["state"] * 1e3:
        figures.failures.append(f"state: older than {STATE_PERIODS} periods")
    if figures.reliable_missing:
        figures.failures.append(f"reliable: {figures.reliable_missing} missing")


@dataclass
class Stops:
    """The result of cuts while driving.

    Attributes:
        times_s: from each cut until the base stood.
        oldest_s: greatest age of a command that the base has obeyed.
        by_itself: commands obeyed after the link had returned, although the operator had let go.
    """

    times_s: list[float] = field(default_factory=list)
    oldest_s: float = 0.0
    by_itself: int = 0


def cut_while_driving(pair: Pair, count: int, seed: int = 0) -> Stops:
    """Cut the network at random moments, and restore it a second later. Meanwhile the operator lets go."""
    random = np.random.default_rng(seed)
    cuts = []
    pair.network.set(GOOD)
    for _ in range(count):
        time.sleep(random.uniform(0.5, 0.8))
        pair.network.cut()
        cut_s = time.monotonic()
        time.sleep(random.uniform(0.0, CUT_S))
        pair.let_go(True)
        time.sleep(max(0.0, cut_s + CUT_S - time.monotonic()))
        mended_s = time.monotonic()
        pair.network.restore()
        pair.wait_until_linked(["state"])
        time.sleep(LINKED_S)
        cuts.append((cut_s, mended_s, time.monotonic()))
        pair.let_go(False)
        pair.wait_until_linked()
    pair.network.set(PERFECT)
    commands = pair.received("manual")
    stops = Stops(oldest_s=max(one.latency_s for one in commands))
    for cut_s, mended_s, held_s in cuts:
        last = max(one.at_s + one.valid_s for one in commands if one.at_s < mended_s)
        stops.times_s.append(max(0.0, last - cut_s))
        stops.by_itself += sum(mended_s <= one.at_s < held_s for one in commands)
    return stops


OPERATED = Conditions(5e6, delay_s=0.05)


def operate(pair: Pair, duration_s: float) -> str:
    """Drive a robot with a camera and a map over a slow network; return what its operator has.

    Args:
        pair: from `operated_pair`.
        duration_s: length of the measurement.
    """
    pair.network.set(OPERATED)
    time.sleep(SETTLE_S)
    began_s = time.monotonic()
    time.sleep(duration_s)
    ended_s = time.monotonic()
    pair.network.set(PERFECT)
    lines = []
    for topic in ("manual", *SEEN_S):
        found = [one for one in pair.received(topic) if began_s <= one.at_s < ended_s]
        late = [one.latency_s * 1e3 for one in found] or [math.nan]
        p50, p99 = np.percentile(late, [50, 99])
        age = _greatest_age_s(pair.received(topic), began_s, ended_s)
        lines.append(
            f"{topic}: {len(found) / duration_s:.1f}/s, p50 {p50:.0f}, p99 {p99:.0f} ms, "
            f"at most {age:.2f} s old"
        )
    return "\n".join(lines)
