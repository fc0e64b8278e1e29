"""Times in shared memory: what is read is what was recorded, within the error that is stated."""

import statistics
from array import array
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.bus.transport.histogram import (
    ABSOLUTE_ERROR_S,
    MAX_TIME_NS,
    RELATIVE_ERROR,
    Distribution,
    Histogram,
    WorkFigures,
    middle_s,
)
from robbie_mp.bus.transport.layout import HISTOGRAM_BUCKETS, HISTOGRAM_WORDS

TIMES = st.lists(st.integers(0, MAX_TIME_NS), min_size=1, max_size=50)


def recorded(waited: list[int], took: list[int]) -> tuple[Histogram, Histogram]:
    words = array("Q", bytes(8 * (2 * HISTOGRAM_WORDS + 5)))
    figures = WorkFigures(words, 5)
    for pair in zip(waited, took, strict=True):
        figures.record(*pair)
    assert not any(words[:5]), "it wrote beside its place"
    read = np.array(words)
    return Histogram.read(read, 5), Histogram.read(read, 5 + HISTOGRAM_WORDS)


def is_near(found_s: float | None, true_ns: float) -> bool:
    true_s = true_ns / 1e9
    return found_s is not None and abs(found_s - true_s) <= RELATIVE_ERROR * true_s + ABSOLUTE_ERROR_S


@given(TIMES)
def test_quantiles_are_within_the_stated_error_and_the_rest_is_exact(times: list[int]) -> None:
    ordered = sorted(times)
    for histogram in recorded(times, times):
        found = histogram.distribution()
        assert found.count == len(times)
        assert is_near(found.p50_s, ordered[(len(times) + 1) // 2 - 1])
        assert is_near(found.p99_s, ordered[-1]), "of up to 50 times, p99 is the longest"
        assert found.mean_s is not None
        assert abs(found.mean_s - statistics.fmean(times) / 1e9) < 1e-9
        assert found.max_s == max(times) / 1e9


def test_waiting_and_working_are_told_apart() -> None:
    waited, took = recorded([1000, 2000], [50_000, 70_000])
    assert waited.distribution().max_s == 2e-6
    assert took.distribution().max_s == 70e-6


@given(TIMES, TIMES)
def test_what_came_since_an_earlier_reading_is_told_apart(before: list[int], after: list[int]) -> None:
    first, _ = recorded(before, before)
    both, _ = recorded(before + after, before + after)
    found, ordered = both.distribution(first), sorted(after)
    assert found.count == len(after)
    assert is_near(found.p50_s, ordered[(len(after) + 1) // 2 - 1])
    assert is_near(found.p99_s, ordered[-1])
    assert is_near(found.max_s, ordered[-1])


def test_nothing_recorded_is_no_time_at_all() -> None:
    empty, _ = recorded([], [])
    assert empty.distribution() == Distribution()
    some, _ = recorded([5], [5])
    assert some.distribution(some) == Distribution()


def test_times_beyond_all_bounds_fall_into_the_outermost_buckets() -> None:
    waited, _ = recorded([-5, 1 << 63, -(1 << 64)], [MAX_TIME_NS + 1] * 3)
    assert waited.counts[0] == 2
    assert waited.counts[HISTOGRAM_BUCKETS - 1] == 1


def test_buckets_are_in_the_order_of_their_times() -> None:
    assert all(a < b for a, b in pairwise(map(middle_s, range(HISTOGRAM_BUCKETS))))
    assert is_near(middle_s(HISTOGRAM_BUCKETS - 1), MAX_TIME_NS)


def test_garbage_in_the_words_gives_no_figures() -> None:
    garbage = Histogram.read(np.full(HISTOGRAM_WORDS, (1 << 64) - 1, np.uint64), 0)
    garbage.distribution()
    assert Histogram.read(np.zeros(HISTOGRAM_WORDS, np.uint64), 0).distribution(garbage).mean_s is not None
