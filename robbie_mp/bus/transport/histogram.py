"""Histograms of durations in shared memory: a module writes them, observers read them.

The buckets are those of HdrHistogram (G. Tene, hdrhistogram.org): each power of two is divided into 16
equal parts. So the error of a quantile is at most 1/32 of it, or 32 ns. Times above 18 minutes count as
18 minutes.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_mp.bus.transport.layout import HISTOGRAM_WORDS
from robbie_mp.bus.transport.words import WORD_MAX, Words

SUM_NS = 0
MAX_NS = 1
BUCKETS = 2

UNIT_BITS = 6
"""Times are counted in units of 64 ns."""
PARTS_BITS = 4
PARTS = 1 << PARTS_BITS
RELATIVE_ERROR = 1 / (2 * PARTS)
ABSOLUTE_ERROR_S = (1 << UNIT_BITS) / 2e9
MAX_TIME_NS = (1 << 40) - 1


class WorkFigures:
    """Two histograms of one kind of work: how long each piece waited to start, and how long it took.

    Args:
        words: the segment of the histograms, which only this process writes.
        at: first of their `2 * HISTOGRAM_WORDS` words.
    """

    __slots__ = ("_at", "_words")

    def __init__(self, words: Words, at: int):
        self._words = words
        self._at = at

    def record(self, waited_ns: int, took_ns: int) -> None:
        """Count one piece of work. It is called for each message, so it is one function without calls.

        Whatever a wild pointer has written into the words, this does not fail: sums are taken modulo 2^64.
        """
        words, at = self._words, self._at
        if not 0 <= waited_ns <= MAX_TIME_NS:  # another process says when it was published
            waited_ns = 0 if waited_ns < 0 else MAX_TIME_NS
        units = waited_ns >> 6
        shift = units.bit_length() - 5
        bucket = at + 2 + ((shift << 4) + (units >> shift) if shift > 0 else units)
        words[bucket] = words[bucket] + 1 & WORD_MAX
        words[at] = words[at] + waited_ns & WORD_MAX
        if waited_ns > words[at + 1]:  # noqa: PLR1730 (it would store the maximum again and again)
            words[at + 1] = waited_ns

        took_ns = min(took_ns, MAX_TIME_NS)
        at += HISTOGRAM_WORDS
        units = took_ns >> 6
        shift = units.bit_length() - 5
        bucket = at + 2 + ((shift << 4) + (units >> shift) if shift > 0 else units)
        words[bucket] = words[bucket] + 1 & WORD_MAX
        words[at] = words[at] + took_ns & WORD_MAX
        if took_ns > words[at + 1]:  # noqa: PLR1730 (it would store the maximum again and again)
            words[at + 1] = took_ns


@dataclass(frozen=True)
class Distribution:
    """Statistics of durations: quantiles have an error of up to 1/32, mean and maximum are exact."""

    count: int = 0
    mean_s: float | None = None
    """None, like the others, if `count` is 0."""
    p50_s: float | None = None
    p99_s: float | None = None
    max_s: float | None = None


class Histogram:
    """A copy of a histogram at one moment.

    Attributes:
        counts: `(HISTOGRAM_BUCKETS,)`.
    """

    def __init__(self, sum_ns: int, max_ns: int, counts: NDArray[np.int64]):
        self.sum_ns = sum_ns
        self.max_ns = max_ns
        self.counts = counts

    @classmethod
    def read(cls, words: NDArray[np.uint64], at: int) -> "Histogram":
        """Read a histogram from a copy of its segment."""
        counts = words[at + BUCKETS : at + HISTOGRAM_WORDS].astype(np.int64)
        return cls(int(words[at + SUM_NS]), int(words[at + MAX_NS]), counts)

    def distribution(self, since: "Histogram | None" = None) -> Distribution:
        """Return its statistics.

        Args:
            since: an earlier copy: only later times count. The maximum is then only as exact as the
                quantiles, unless it is the largest of all.
        """
        counts = self.counts - since.counts if since else self.counts
        total = int(counts.sum())
        if total <= 0 or counts.min() < 0:  # nothing, or garbage, or of another incarnation
            return Distribution()
        max_s = self.max_ns / 1e9
        if since and since.max_ns == self.max_ns:
            max_s = min(max_s, middle_s(int(np.flatnonzero(counts)[-1])))
        sum_ns = self.sum_ns - (since.sum_ns if since else 0)
        p50_s, p99_s = (min(max_s, quantile_s(counts, fraction)) for fraction in (0.5, 0.99))
        return Distribution(total, sum_ns / total / 1e9, p50_s, p99_s, max_s)


def quantile_s(counts: NDArray[np.int64], fraction: float) -> float:
    """Return the quantile in s, within the error that the module's docstring states."""
    passed = counts.cumsum()
    return middle_s(int(np.searchsorted(passed, max(1, math.ceil(fraction * passed[-1])))))


def middle_s(bucket: int) -> float:
    """Return the middle of a bucket in s."""
    shift = max(0, (bucket >> PARTS_BITS) - 1)
    units = bucket - (shift << PARTS_BITS)
    return ((units << shift) + (1 << shift) / 2) * (1 << UNIT_BITS) / 1e9
