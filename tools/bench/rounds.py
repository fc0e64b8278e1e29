"""Runs contenders in turn, round after round, so that whatever else the machine does strikes all of them."""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.bench.contender import Contender, Outcome, Trouble
from tools.bench.work import Work

LEFT_OUT = "left out by --quick"


@dataclass
class Series:
    """What one contender did, round after round.

    Attributes:
        contender: who.
        changes: in what its work differs from that of the others.
        suffix: of its name and title, saying so.
        outcomes: of the rounds in which it did its work.
        rounds: the numbers of these rounds.
        trouble: why it did not, the last time; or why it is absent.
    """

    contender: Contender
    changes: dict[str, Any] = field(default_factory=dict)
    suffix: str = ""
    outcomes: list[Any] = field(default_factory=list)
    rounds: list[int] = field(default_factory=list)
    trouble: str = ""

    def describe(self) -> dict[str, Any]:
        """Say who it is and how it went."""
        contender = self.contender
        return {
            "name": " ".join(filter(None, (contender.name, self.suffix))),
            "title": ", ".join(filter(None, (contender.title, self.suffix))),
            "version": contender.version,
            "how": contender.how,
            "trouble": self.trouble,
            "rounds": self.rounds,
        }


def run_rounds(
    series: Sequence[Series], run: Callable[[Series], Any], rounds: int, budget_s: float | None = None
) -> None:
    """Run each contender once in each round, each round beginning with another one.

    A contender that is absent, or cannot do the work in a round, is left out from then on.

    Args:
        series: takes what `run` returns.
        run: does the work once.
        rounds: how many.
        budget_s: start nothing after so long.
    """
    began_s = time.monotonic()
    for one in series:
        one.trouble = one.contender.why_absent
    present = [one for one in series if not one.trouble]
    for number in range(rounds):
        for one in (*present[number:], *present[:number]) if number < len(present) else present:
            if one.trouble or (budget_s is not None and time.monotonic() - began_s > budget_s):
                continue
            _say(f"round {number + 1} of {rounds}: {one.describe()['title']}")
            try:
                one.outcomes.append(run(one))
                one.rounds.append(number)
            except Trouble as trouble:
                one.trouble = str(trouble)
    for one in present:
        if not one.outcomes and not one.trouble:
            one.trouble = LEFT_OUT
    _say("")


def run_work(
    series: Sequence[Series], work: Work, rounds: int, budget_s: float | None = None
) -> list[dict[str, Any]]:
    """Have all do the same work, each with its own changes; return their figures."""
    run_rounds(series, lambda one: one.contender.run(replace(work, **one.changes)), rounds, budget_s)
    return [one.describe() | (_figures(one.outcomes) if one.outcomes else {}) for one in series]


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
    """For each round the quantiles of latency, the rate, and what was lost.

    Where nothing arrived there are no quantiles: None.
    """
    received = [last_of_all(outcome) for outcome in outcomes]
    return {
        "sent": [outcome.sent for outcome in outcomes],
        "wanted": [outcome.sent * len(outcome.latencies_ns) for outcome in outcomes],
        "lost": [outcome.lost for outcome in outcomes],
        "received_per_s": [_received_per_s(outcome) for outcome in outcomes],
        "p50_us": [_quantile(one, 0.5) for one in received],
        "p99_us": [_quantile(one, 0.99) for one in received],
    }


def _quantile(values: NDArray[np.float64], quantile: float) -> float | None:
    return float(np.quantile(values, quantile)) if values.size else None


def _received_per_s(outcome: Outcome) -> float:
    received = outcome.sent - outcome.lost / len(outcome.latencies_ns)
    return received / outcome.took_s if outcome.took_s > 0 else 0.0
