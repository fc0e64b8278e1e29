"""Runs contenders in turn, round after round, so that whatever else the machine does strikes all of them."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.bench.contender import Contender, Outcome, Trouble
from tools.bench.work import Work


@dataclass
class Series:
    """What one contender did, round after round.

    Attributes:
        contender: who.
        outcomes: of the rounds in which it did its work.
        trouble: why it did not, the last time; or why it is absent.
    """

    contender: Contender
    outcomes: list[Outcome] = field(default_factory=list)
    trouble: str = ""

    def as_data(self) -> dict[str, Any]:
        """Return what tables and JSON say of it."""
        contender = self.contender
        data: dict[str, Any] = {
            "name": contender.name,
            "title": contender.title,
            "version": contender.version,
            "how": contender.how,
            "trouble": self.trouble,
            "rounds": len(self.outcomes),
        }
        if self.outcomes:
            data |= _figures(self.outcomes)
        return data


def run_rounds(contenders: Sequence[Contender], work: Work, rounds: int) -> list[Series]:
    """Run each contender once in each round.

    A contender that is absent, or cannot do the work in a round, is left out from then on.
    """
    series = [Series(contender, trouble=contender.why_absent) for contender in contenders]
    for number in range(rounds):
        for one in series:
            if one.trouble:
                continue
            _say(f"round {number + 1} of {rounds}: {one.contender.title}")
            try:
                one.outcomes.append(one.contender.run(work))
            except Trouble as trouble:
                one.trouble = str(trouble)
    _say("")
    return series


def _say(text: str) -> None:
    """Show on a terminal what is being done."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


def last_of_all(outcome: Outcome) -> NDArray[np.float64]:
    """Return for each message that all subscribers got the time until the last one had it, in µs."""
    of_each = np.array([one[: outcome.sent] for one in outcome.latencies_ns])
    complete = (of_each > 0).all(axis=0)
    return np.asarray(of_each[:, complete].max(axis=0) / 1e3, np.float64)


def _figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Median over the rounds of each round's quantiles, and of its rate; the sum of what was lost."""
    received = [latencies for outcome in outcomes if (latencies := last_of_all(outcome)).size]
    sent = sum(outcome.sent for outcome in outcomes)
    figures: dict[str, Any] = {
        "sent": sent,
        "lost": sum(outcome.lost for outcome in outcomes),
        "rate_hz": [_rate_hz(outcome) for outcome in outcomes],
    }
    for name, quantile in (("p50_us", 0.5), ("p99_us", 0.99)):
        figures[name] = [float(np.quantile(latencies, quantile)) for latencies in received]
    return figures


def _rate_hz(outcome: Outcome) -> float:
    received = outcome.sent - outcome.lost / len(outcome.latencies_ns)
    return received / outcome.took_s if outcome.took_s > 0 else 0.0
