"""Rings, as they are written in Python and in C: both ends of each behave alike."""

from array import array
from dataclasses import replace
from importlib import import_module
from types import ModuleType
from typing import Any

import pytest

from robbie_mp.base.linux.forks import ForkedProcess
from robbie_mp.bus.transport import ring
from robbie_mp.bus.transport.ring import RingCorrupt, RingPlace

CAPACITY = 8


@pytest.fixture(params=["Python", "C"])
def ends(request: pytest.FixtureRequest) -> ModuleType:
    """The module that has the ends of the rings."""
    return ring if request.param == "Python" else built()


def built() -> ModuleType:
    try:
        return import_module("robbie_mp.bus._hot.native")
    except ImportError:
        pytest.skip("NOT TESTED, the C is not built here")


def place() -> RingPlace:
    return RingPlace(array("Q", bytes(8 * 100)), 0, 2, CAPACITY, array("Q", bytes(8)), 0)


def test_records_come_out_as_they_went_in_round_and_round(ends: ModuleType) -> None:
    at = place()
    writer, reader = ends.RingWriter(at), ends.RingReader(at)
    seen = []
    for value in range(50):
        writer.push(value, 1, 2, 3, 4, 5, 2**64 - 1)
        if value % 3 == 2:
            for _ in range(reader.waiting()):
                seen.append(reader.peek()[:7])
                reader.take()
    assert seen == [(value, 1, 2, 3, 4, 5, 2**64 - 1) for value in range(48)]


def test_room_shrinks_until_the_reader_takes(ends: ModuleType) -> None:
    at = place()
    writer, reader = ends.RingWriter(at), ends.RingReader(at)
    for _ in range(CAPACITY):
        writer.push(0, 0, 0, 0, 0, 0, 0)
    assert writer.room() == 0
    assert reader.waiting() == CAPACITY
    reader.take()
    assert writer.room() == 1


def test_new_ends_go_on_where_the_old_ones_stopped(ends: ModuleType) -> None:
    at = place()
    ends.RingWriter(at).push(1, 0, 0, 0, 0, 0, 0)
    first = ends.RingReader(at)
    assert first.waiting() == 1
    first.take()
    ends.RingWriter(at).push(2, 0, 0, 0, 0, 0, 0)
    second = ends.RingReader(at)
    assert second.waiting() == 1
    assert second.peek()[0] == 2


@pytest.mark.parametrize("head", [CAPACITY + 1, 2**63, 2**64 - 1])
def test_impossible_head_is_noticed(ends: ModuleType, head: int) -> None:
    at = place()
    at.words[0] = head
    with pytest.raises(RingCorrupt):
        ends.RingReader(at).waiting()


def test_head_that_goes_back_is_noticed(ends: ModuleType) -> None:
    at = place()
    writer, reader = ends.RingWriter(at), ends.RingReader(at)
    writer.push(0, 0, 0, 0, 0, 0, 0)
    assert reader.waiting() == 1
    reader.take()
    at.words[0] = 0
    with pytest.raises(RingCorrupt):
        reader.waiting()


def test_record_without_its_number_is_noticed(ends: ModuleType) -> None:
    at = place()
    at.words[0] = 1
    reader = ends.RingReader(at)
    assert reader.waiting() == 1
    with pytest.raises(RingCorrupt, match="record 0"):
        reader.peek()


def test_numbers_come_out_in_order_round_and_round(ends: ModuleType) -> None:
    at = place()
    writer, reader = ends.NumberRingWriter(at), ends.NumberRingReader(at)
    seen = []
    for number in range(50):
        writer.push(number)
        if number % CAPACITY == CAPACITY - 1:
            seen += reader.take_all()
    assert seen == list(range(48))
    assert reader.take_all() == [48, 49]
    assert reader.take_all() == []


@pytest.mark.parametrize("tail", [2, 2**63, 2**64 - 1])
def test_tail_that_no_reader_can_have_leaves_no_room(ends: ModuleType, tail: int) -> None:
    at = place()
    writer = ends.RingWriter(at)
    writer.push(0, 0, 0, 0, 0, 0, 0)
    at.tail_words[0] = tail
    assert writer.room() == 0


@pytest.mark.parametrize(("head", "waiting"), [(CAPACITY + 4, "9"), (1, "-2"), (2**63, f"{2**63 - 3}")])
def test_corrupt_ring_says_how_many_records_seem_to_wait(ends: ModuleType, head: int, waiting: str) -> None:
    at = replace(place(), tail_words=array("Q", [3]))
    at.words[0] = head
    for reader in (ends.RingReader(at), ends.NumberRingReader(at)):
        with pytest.raises(RingCorrupt, match=f"a ring of 8 records claims that {waiting} wait"):
            getattr(reader, "next" if hasattr(reader, "next") else "take_all")()
    assert at.tail_words[0] == 3


def test_next_takes_records_one_by_one(ends: ModuleType) -> None:
    at = place()
    writer, reader = ends.RingWriter(at), ends.RingReader(at)
    assert reader.next() is None
    writer.push(7, 1, 2, 3, 4, 5, 6)
    assert reader.glance() == 7
    assert reader.next() == (7, 1, 2, 3, 4, 5, 6, 1)
    assert at.tail_words[0] == reader.tail == writer.head == 1
    assert reader.next() is None


@pytest.mark.parametrize("word", [-1, 2**64, "1", 1.0])
def test_what_is_no_word_is_not_pushed(ends: ModuleType, word: object) -> None:
    at = place()
    with pytest.raises((OverflowError, TypeError)):
        ends.RingWriter(at).push(0, 0, 0, word, 0, 0, 0)
    assert at.words[0] == 0


@pytest.fixture
def native() -> ModuleType:
    return built()


def test_memory_cannot_go_while_an_end_in_c_uses_it(native: ModuleType) -> None:
    memory = bytearray(8 * 100)
    words = memoryview(memory).cast("Q")
    at = replace(place(), words=words)
    ends = native.RingWriter(at), native.RingReader(at)
    words.release()  # Python's view of it may go, as in a forked process
    with pytest.raises(BufferError):
        memory.clear()
    for end in ends:
        end.close()
    memory.clear()
    with pytest.raises(ValueError, match="closed"):
        ends[0].push(0, 0, 0, 0, 0, 0, 0)
    with pytest.raises(ValueError, match="closed"):
        ends[1].waiting()


@pytest.mark.parametrize(
    ("kind", "use", "words"),
    [
        ("RingWriter", "push", 7),
        ("RingReader", "next", 0),
        ("NumberRingWriter", "push", 1),
        ("NumberRingReader", "take_all", 0),
    ],
)
def test_end_in_c_refuses_a_forked_process(native: ModuleType, kind: str, use: str, words: int) -> None:
    end = getattr(native, kind)(place())
    end.disown()
    with pytest.raises(ForkedProcess):
        getattr(end, use)(*[0] * words)


@pytest.mark.parametrize(
    "wrong",
    [
        {"head_at": 100},
        {"records_at": 101},
        {"capacity": 7},
        {"capacity": 0},
        {"capacity": 16},
        {"tail_at": 1},
    ],
)
def test_ring_beyond_its_memory_is_refused_in_c(native: ModuleType, wrong: dict[str, Any]) -> None:
    for kind in ("RingWriter", "RingReader"):
        with pytest.raises(ValueError, match="does not fit"):
            getattr(native, kind)(replace(place(), **wrong))
