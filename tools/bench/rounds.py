"""Runs contenders in turn, round after round, so that other load on the machine affects all of them."""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.bench.contender import Contender, Trouble, WorkResult
from tools.bench.work import Work

Watched = Callable[[Callable[[], Any]], Any]
"""Calls what measures, and returns its result; see `QuietMachine`."""
LEFT_OUT = "left out by --quick"


@dataclass
class Series:
    """The results of one contender over all rounds.

    Attributes:
        contender: the contender.
        changes: fields of its work that differ from those of the others.
        suffix: suffix of its name and title, which describes the changes.
        outcomes: results of the rounds in which it did its work.
        rounds: numbers of these rounds.
        trouble: why it failed in the last round, or why it is absent.
    """

    contender: Contender
    changes: dict[str, Any] = field(default_factory=dict)
    suffix: str = ""
    outcomes: list[Any] = field(default_factory=list)
    rounds: list[int] = field(default_factory=list)
    trouble: str = ""

    def describe(self) -> dict[str, Any]:
        """Return the contender's description and the state of this series."""
        contender = self.contender
        return {
            "name": " ".join(filter(None, (contender.name, self.suffix))),
            "title": ", ".join(filter(None, (contender.title, self.suffix))),
            "version": contender.version,
            "how": contender.how,
            "trouble": self.trouble,
            "rounds": self.rounds,
        }


def unwatched(measure: Callable[[], Any]) -> Any:
    """Measure, whatever else the machine does."""
    return measure()


def run_rounds(
    series: Sequence[Series],
    run: Callable[[Series], Any],
    rounds: int,
    budget_s: float | None = None,
    watched: Watched = unwatched,
) -> None:
    """Run each contender once in each round. Each round begins with a different contender.

    A contender that is absent or fails in a round takes no part in later rounds.

    Args:
        series: the contenders; each series receives what `run` returns.
        run: does the work once.
        rounds: number of rounds.
        budget_s: time after which no further contender is started; None: no limit.
        watched: calls what measures; raises `Trouble` if the machine was too busy.
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
                one.outcomes.append(watched(partial(run, one)))
                one.rounds.append(number)
            except Trouble as trouble:
                one.trouble = str(trouble)
    for one in present:
        if not one.outcomes and not one.trouble:
            one.trouble = LEFT_OUT
    _say("")


def run_work(
    series: Sequence[Series],
    work: Work,
    rounds: int,
    budget_s: float | None = None,
    watched: Watched = unwatched,
) -> list[dict[str, Any]]:
    """Run the same work with all contenders, each with its changes, and return their figures."""

    def run(one: Series) -> WorkResult:
        return one.contender.run(replace(work, **one.changes))

    run_rounds(series, run, rounds, budget_s, watched)
    return [one.describe() | (figures(one.outcomes) if one.outcomes else {}) for one in series]


def _say(text: str) -> None:
    """Show the progress, if the output is a terminal."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


def last_of_all(outcome: WorkResult) -> NDArray[np.float64]:
    """Return for each message that all subscribers received the time until the last one had it, in µs."""
    of_each = np.array([one[: outcome.sent] for one in outcome.latencies_ns])
    complete = (of_each > 0).all(axis=0)
    return np.asarray(of_each[:, complete].max(axis=0) / 1e3, np.float64)


def figures(outcomes: Sequence[WorkResult]) -> dict[str, Any]:
    """Return the quantiles of latency, the rate and the losses of each round.

    The quantiles of a round in which nothing arrived are None.
    """
    received = [last_of_all(outcome) for outcome in outcomes]
    return {
        "sent": [outcome.sent for outcome in outcomes],
        "wanted": [outcome.sent * len(outcome.latencies_ns) for outcome in outcomes],
        "lost": [outcome.lost for outcome in outcomes],
        "received_per_s": [_received_per_s(outcome) for outcome in outcomes],
        "p50_us": [_quantile(one, 0.5) for one in received],
        "p99_us": [_quantile(one, 0.99) for one in received],
        "p999_us": [_quantile(one, 0.999) for one in received],
    }


def _quantile(values: NDArray[np.float64], quantile: float) -> float | None:
    return float(np.quantile(values, quantile)) if values.size else None


def _received_per_s(outcome: WorkResult) -> float:
    received = outcome.sent - outcome.lost / len(outcome.latencies_ns)
    return received / outcome.took_s if outcome.took_s > 0 else 0.0
