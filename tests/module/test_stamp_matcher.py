"""Sets of messages that belong together, compared with a search through all possible sets."""

from itertools import pairwise, product

from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.module.stamp_matcher import MAX_LATE_NS, StampMatcher

Stamps = list[list[int]]
Sets = list[tuple[int, ...]]
FAR = 10_000
PLENTY = 1000


def every_set(topics: Stamps, tolerance: int) -> Sets:
    """The sets as the module's page defines them, found by trying all."""
    rest = [list(stamps) for stamps in topics]
    found: Sets = []
    while True:
        while all(rest) and max(s[0] for s in rest) - min(s[0] for s in rest) > tolerance:
            min(rest, key=lambda stamps: stamps[0]).pop(0)
        if not all(rest):
            return found
        pivot = max(stamps[0] for stamps in rest)
        sets = [
            (max(chosen) - min(chosen), min(chosen), places, chosen)
            for places in product(*(range(len(stamps)) for stamps in rest))
            if pivot in (chosen := tuple(s[place] for s, place in zip(rest, places, strict=True)))
            and any(not place and s[0] == pivot for s, place in zip(rest, places, strict=True))
        ]
        _, _, places, chosen = min(sets)
        found.append(chosen)
        rest = [stamps[place + 1 :] for stamps, place in zip(rest, places, strict=True)]


class Found:
    """A matcher that remembers what it delivers."""

    def __init__(
        self, topics: int, tolerance: int = 0, max_waiting: int = PLENTY, periods: tuple[int, ...] = ()
    ):
        self.sets: Sets = []
        self.matcher = StampMatcher(
            topics,
            lambda *messages: self.sets.append(messages),
            tolerance,
            max_waiting,
            periods or (0,) * topics,
        )

    def add(self, topic: int, *stamps: int) -> "Found":
        for stamp in stamps:
            self.matcher.add(topic, stamp, stamp)
        self.check()
        return self

    def check(self) -> None:
        for count in self.matcher.counts:
            assert count.received == count.matched + count.left_over + count.waiting
            assert count.matched == len(self.sets)


@st.composite
def streams(draw: st.DrawFn, max_topics: int = 3) -> Stamps:
    topics = draw(st.integers(2, max_topics))
    return [[*sorted(draw(st.lists(st.integers(0, 40), max_size=7))), FAR] for _ in range(topics)]


@st.composite
def interleaved(draw: st.DrawFn, topics: Stamps) -> list[int]:
    """The topic of each message, in some order of arrival."""
    numbers = [number for number, stamps in enumerate(topics) for _ in stamps]
    return draw(st.permutations(numbers))


def deliver(found: Found, topics: Stamps, order: list[int]) -> Sets:
    arriving = [iter(stamps) for stamps in topics]
    for number in order:
        found.add(number, next(arriving[number]))
    return found.sets


@settings(max_examples=200, deadline=None)
@given(st.data(), streams(), st.integers(0, 12))
def test_sets_are_those_of_an_exhaustive_search_in_any_order_of_arrival(
    data: st.DataObject, topics: Stamps, tolerance: int
) -> None:
    order = data.draw(interleaved(topics))
    assert deliver(Found(len(topics), tolerance), topics, order) == every_set(topics, tolerance)


@settings(max_examples=100, deadline=None)
@given(st.data(), streams(), st.integers(0, 12))
def test_known_periods_do_not_change_the_sets(data: st.DataObject, topics: Stamps, tolerance: int) -> None:
    periods = tuple(min((b - a for a, b in pairwise(s)), default=0) for s in topics)
    order = data.draw(interleaved(topics))
    found = Found(len(topics), tolerance, periods=periods)
    assert deliver(found, topics, order) == every_set(topics, tolerance)


@settings(max_examples=100, deadline=None)
@given(st.data(), st.integers(2, 3), st.integers(0, 12), st.integers(1, 4))
def test_whatever_arrives_is_bounded_in_order_near_and_counted(
    data: st.DataObject, topics: int, tolerance: int, max_waiting: int
) -> None:
    found = Found(topics, tolerance, max_waiting)
    stamps = st.integers(-3, 60) | st.sampled_from((-2 * MAX_LATE_NS, 2 * MAX_LATE_NS))
    newest: dict[int, int] = {}
    first = 0
    for number, stamp in data.draw(st.lists(st.tuples(st.integers(0, topics - 1), stamps), max_size=40)):
        if newest.get(number, stamp) - stamp > MAX_LATE_NS:  # the clock was set back: all begins again
            newest.clear()
            first = len(found.sets)
        newest[number] = max(newest.get(number, stamp), stamp)
        found.add(number, stamp)
        assert all(count.waiting <= max_waiting for count in found.matcher.counts)
        assert all(max(one) - min(one) <= tolerance for one in found.sets)
        for earlier, later in pairwise(found.sets[first:]):
            assert all(a <= b for a, b in zip(earlier, later, strict=True))


def test_equal_stamps_match_at_once_and_others_are_left_over() -> None:
    found = Found(2).add(0, 1, 2, 3).add(1, 2)
    assert found.sets == [(2, 2)]
    assert [count.unmatched for count in found.matcher.counts] == [1, 0]
    assert found.add(1, 3).sets == [(2, 2), (3, 3)]


def test_nearest_is_waited_for_unless_it_cannot_come() -> None:
    found = Found(2, tolerance=5).add(0, 10).add(1, 12)
    assert not found.sets, "11 might still come"
    assert found.add(0, 20).sets == [(10, 12)]
    assert Found(2, tolerance=5, periods=(8, 0)).add(0, 10).add(1, 12).sets == [(10, 12)]


def test_nearer_message_takes_the_place_of_an_earlier_one() -> None:
    found = Found(2, tolerance=5).add(0, 10).add(1, 13).add(0, 14)
    assert found.sets == [(14, 13)]
    assert found.matcher.counts[0].unmatched == 1


def test_message_too_early_for_another_topic_does_not_wait() -> None:
    found = Found(2, tolerance=5).add(0, 10, 20).add(1, 19)
    assert [count.unmatched for count in found.matcher.counts] == [1, 0]
    assert found.matcher.nearest_ns == 9
    assert found.add(1, 30).sets == [(20, 19)]
    found.add(0, 30)
    assert found.matcher.nearest_ns is None


def test_oldest_is_crowded_out_while_a_topic_is_silent() -> None:
    found = Found(2, max_waiting=3).add(0, 1, 2, 3, 4, 5)
    assert (found.matcher.counts[0].crowded_out, found.matcher.counts[0].waiting) == (2, 3)
    assert found.add(1, 4).sets == [(4, 4)]


def test_full_queue_delivers_a_complete_set_rather_than_lose_it() -> None:
    found = Found(2, tolerance=5, max_waiting=2).add(1, 10).add(0, 11, 12)
    assert not found.sets, "11 might still come on the slow topic"
    assert found.add(0, 13).sets == [(11, 10)]
    assert [count.crowded_out for count in found.matcher.counts] == [0, 0]


def test_late_message_is_left_over() -> None:
    found = Found(2).add(0, 5, 4).add(1, 4, 5)
    assert found.sets == [(5, 5)]
    assert found.matcher.counts[0].late == 1


def test_matching_begins_anew_when_stamps_go_back() -> None:
    late = 5 * MAX_LATE_NS
    found = Found(2).add(0, late, late + 1).add(1, late - 1)
    found.add(0, 1).add(1, 1)
    assert found.sets == [(1, 1)]
    assert [count.forgotten for count in found.matcher.counts] == [2, 0]


def test_straggler_from_before_a_jump_costs_no_more_than_one_message_of_each_topic() -> None:
    late = 5 * MAX_LATE_NS
    found = Found(2).add(0, late).add(1, late)
    found.add(0, 1).add(1, late + 1)
    found.add(0, 2).add(1, 2).add(0, 3).add(1, 3)
    assert (3, 3) in found.sets
