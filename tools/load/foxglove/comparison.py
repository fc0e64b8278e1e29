"""Compares latencies with and without clients, over several rounds.

Single rounds differ more from each other than the clients' effect. So the messages of all rounds are taken
together, and the interval of a ratio comes from rounds that are drawn again and again, with replacement
(B. Efron, Bootstrap Methods: Another Look at the Jackknife, 1979).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_mp.bus.transport.histogram import middle_s, quantile_s

RESAMPLES = 2000
LEVEL = 0.95

Counts = NDArray[np.int64]


class Ratio(NamedTuple):
    """A ratio of two quantiles and its 95 % interval."""

    value: float
    low: float
    high: float


def quantile_us(rounds: Sequence[Sequence[int]], fraction: float) -> float:
    """Return a quantile of the messages of all rounds, us.

    Args:
        rounds: the messages of each round, by the buckets of `Histogram`.
        fraction: such as 0.99.
    """
    return 1e6 * quantile_s(np.asarray(rounds, np.int64).sum(axis=0), fraction)


def compare(rounds: Sequence[Sequence[int]], others: Sequence[Sequence[int]], fraction: float) -> Ratio:
    """Return the ratio of a quantile to that of other sessions, which were measured in the same rounds.

    Args:
        rounds: the messages of each round, by the buckets of `Histogram`.
        others: those of the other sessions, in the same order.
        fraction: such as 0.99.
    """
    chosen = np.random.default_rng(0).multinomial(len(rounds), [1 / len(rounds)] * len(rounds), RESAMPLES)
    resampled, resampled_others = (
        _quantiles_s(chosen @ np.asarray(counts, np.int64), fraction) for counts in (rounds, others)
    )
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(resampled / resampled_others, (tail, 1 - tail))
    return Ratio(quantile_us(rounds, fraction) / quantile_us(others, fraction), float(low), float(high))


def _quantiles_s(counts: Counts, fraction: float) -> NDArray[np.float64]:
    """Return the quantile of each row of counts, s."""
    passed = counts.cumsum(axis=1)
    wanted = np.maximum(1, np.ceil(fraction * passed[:, -1:]))
    return np.array([middle_s(bucket) for bucket in (passed < wanted).sum(axis=1).tolist()])
