"""C makes the same stores as Python, in the same order, for every use of a ring, and returns the same."""

from types import ModuleType
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robbie_mp.bus.transport import ring
from robbie_mp.bus.transport.ring import RingPlace
from robbie_mp.bus.transport.words import WORD_MAX
from tests.bus.core._support.memory import Died
from tests.bus.hot._support.trace import described

CAPACITY = 4
WORDS = 2 + 8 * CAPACITY
WORD = st.one_of(
    st.integers(0, 2 * CAPACITY),
    st.sampled_from([2**32, 2**63, WORD_MAX - 1, WORD_MAX]),
    st.integers(0, WORD_MAX),
)
STEP = st.one_of(
    st.tuples(st.just("push"), st.tuples(*[WORD] * 7)),
    st.tuples(st.sampled_from(["room", "waiting", "peek", "glance", "take", "next", "reopen"]), st.just(())),
    st.tuples(st.just("write"), st.tuples(st.integers(0, WORDS - 1), WORD)),
    st.tuples(st.just("write_tail"), st.tuples(WORD)),
    st.tuples(st.just("die_after"), st.tuples(st.integers(0, 12))),
)
NUMBER_STEP = st.one_of(
    st.tuples(st.just("push"), st.tuples(WORD)),
    st.tuples(st.sampled_from(["take_all", "reopen"]), st.just(())),
    st.tuples(st.just("write"), st.tuples(st.integers(0, WORDS - 1), WORD)),
    st.tuples(st.just("write_tail"), st.tuples(WORD)),
    st.tuples(st.just("die_after"), st.tuples(st.integers(0, 3))),
)


class Ends:
    """Both ends of a ring in the test build's memory, and what somebody writes over it."""

    def __init__(self, built: ModuleType, writer: Any, reader: Any):
        self.words, self.tail_words = built.Words(WORDS), built.Words(1)
        self._makers = writer, reader
        self._place = RingPlace(self.words, 0, 2, CAPACITY, self.tail_words, 0)
        self._own: dict[int, int] = {}
        """Head (0) and tail (1) as the ends had stored them, if something wrote over them."""
        self._reopen()
        self.fuse = self.words.fuse = self.tail_words.fuse = built.Fuse(Died)

    def _reopen(self) -> None:
        """Let new processes go on; each trusts the one word that nobody else writes.

        Nobody may die here: half restored, that word would be what the other process wrote.
        """
        self.words[0] = self._own.pop(0, self.words[0])
        self.tail_words[0] = self._own.pop(1, self.tail_words[0])
        self._writer, self._reader = (make(self._place) for make in self._makers)

    def do(self, name: str, arguments: tuple[int, ...]) -> object:
        """Take a step; return what comes of it."""
        if name == "reopen":
            self.fuse.deaths = []
            self._reopen()
        elif name == "write":
            at, word = arguments
            if at == 0:
                self._own.setdefault(0, self.words[0])
            self.words[at] = word
        elif name == "write_tail":
            self._own.setdefault(1, self.tail_words[0])
            [self.tail_words[0]] = arguments
        elif name == "die_after":
            self.fuse.deaths = [self.fuse.stores + arguments[0]]
        else:
            end = self._writer if name in ("push", "room") else self._reader
            return getattr(end, name)(*arguments)
        return None

    def play(self, steps: list[tuple[str, tuple[int, ...]]]) -> list[object]:
        """Take steps; return the result or error of each."""
        results: list[object] = []
        for name, arguments in steps:
            try:
                results.append(self.do(name, arguments))
            except Died:
                results.append("died")
                self.fuse.deaths = []
                self._reopen()
            except (ring.RingCorrupt, OverflowError) as error:
                results.append((type(error), str(error) if isinstance(error, ring.RingCorrupt) else ""))
        return results


def compare(
    built: ModuleType, python: tuple[Any, Any], c: tuple[Any, Any], steps: list[tuple[str, tuple[int, ...]]]
) -> None:
    played = []
    for ends in (python, c):
        built.begin_trace()
        played_ends = Ends(built, *ends)
        played.append((played_ends.play(steps), built.end_trace()))
        assert built.stray_words() == []
    (python_results, python_trace), (c_results, c_trace) = played
    assert c_results == python_results
    assert described(c_trace) == described(python_trace)
    assert built.unguarded_stores() == 0


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(st.lists(STEP, max_size=40))
def test_records_are_stored_alike(built: ModuleType, steps: list[tuple[str, tuple[int, ...]]]) -> None:
    compare(built, (ring.RingWriter, ring.RingReader), (built.RingWriter, built.RingReader), steps)


@pytest.mark.slow
@example([("die_after", (2,)), ("write_tail", (WORD_MAX - 1,)), ("reopen", ()), ("take_all", ())])
@settings(max_examples=300, deadline=None)
@given(st.lists(NUMBER_STEP, max_size=40))
def test_numbers_are_stored_alike(built: ModuleType, steps: list[tuple[str, tuple[int, ...]]]) -> None:
    python = ring.NumberRingWriter, ring.NumberRingReader
    compare(built, python, (built.NumberRingWriter, built.NumberRingReader), steps)


def test_process_dies_before_the_store_that_burns(built: ModuleType) -> None:
    for stores in range(9):
        ends = Ends(built, built.RingWriter, built.RingReader)
        ends.fuse.deaths = [stores]
        with pytest.raises(Died):
            ends.do("push", (1, 2, 3, 4, 5, 6, 7))
        record = [1, 2, 3, 4, 5, 6, 7, 1]
        assert list(ends.words)[2:10] == record[:stores] + [0] * (8 - stores)
        assert ends.words[0] == 0, "the head says so before the record is there"
        assert ends.fuse.stores == stores


def test_memory_that_a_ring_holds_cannot_be_unmapped(built: ModuleType) -> None:
    ends = Ends(built, built.RingWriter, built.RingReader)
    with pytest.raises(BufferError):
        ends.words.close()
    ends._writer.close()
    ends._reader.disown()
    ends.words.close()
    ends.tail_words.close()
