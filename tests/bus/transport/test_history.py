"""The history of a module: what is kept, in C and in Python alike, and what any other bytes read as."""

import os
from array import array
from collections.abc import Iterator
from contextlib import suppress
from mmap import PAGESIZE, mmap
from resource import RUSAGE_THREAD, getrusage

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robbie_mp.bus.transport import history as transport_history
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.history import (
    HEAD_BYTES,
    LARGEST_PUBLISHED_SHARE,
    LARGEST_SHARE,
    Event,
    HistoryWriter,
    OwnHistory,
    PythonHistory,
    history_words,
    read_history,
)
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names
from robbie_mp.run.supervisor.own_history import AT_FIRST_BYTES
from tests._support.implementations import BOTH, NATIVE, Native

RING_BYTES = 1 << 14
RUN = f"testhist{os.getpid()}"
EVENTS = st.lists(st.tuples(st.sampled_from([1, 2, 6]), st.binary(max_size=700)), max_size=80)


def image(segment: Segment) -> bytes:
    """Read a segment as what writes a capsule does."""
    return (SHARED_MEMORY / segment.name).read_bytes()


def taken_bytes(segment: Segment) -> int:
    """Return the memory that a segment takes."""
    return (SHARED_MEMORY / segment.name).stat().st_blocks * 512


def touches_memory_beforehand() -> bool:
    """Whether MADV_POPULATE_WRITE takes memory: not before Linux 5.14, nor in qemu's user emulation."""
    with open(os.memfd_create("probe"), "r+b") as file:
        file.truncate(PAGESIZE)
        with mmap(file.fileno(), PAGESIZE) as page, suppress(OSError):
            page.madvise(23)
        return os.fstat(file.fileno()).st_blocks > 0


GROWS = pytest.mark.skipif(not touches_memory_beforehand(), reason="it cannot touch memory beforehand")


class Kept:
    """A history in the test's own memory."""

    def __init__(self, native: Native | None):
        self.memory = array("Q", bytes(8 * history_words(RING_BYTES)))
        words = memoryview(self.memory)
        self.writer: HistoryWriter = PythonHistory(words) if native is None else native.History(words)

    def image(self) -> bytes:
        return self.memory.tobytes()


@pytest.mark.parametrize("native", BOTH)
def test_newest_records_are_read_in_order_and_the_oldest_are_overwritten(native: Native | None) -> None:
    kept = Kept(native)
    for number in range(1, 501):
        kept.writer.append(Event.MESSAGE, number, 1, 2, 3, 4, bytes([number % 256]) * (number % 90))
    found = read_history(kept.image())
    assert (found.damage, found.is_whole) == ("", False)
    assert [one.number for one in found.records] == list(range(501 - len(found.records), 501))
    assert len(found.records) > RING_BYTES / (HEAD_BYTES + 90) - 3
    assert all(one.data == bytes([one.number % 256]) * (one.number % 90) for one in found.records)
    assert found.records[-1].values == (1, 2, 3, 4)


@pytest.mark.parametrize("native", BOTH)
def test_large_data_are_left_out_but_not_the_record(native: Native | None) -> None:
    kept = Kept(native)
    for data in (bytes(RING_BYTES), bytes(RING_BYTES // LARGEST_SHARE), bytes(RING_BYTES // LARGEST_SHARE)):
        kept.writer.append(Event.MESSAGE, 5, 0, 0, 0, 0, data)
    kept.writer.append(Event.PUBLISHED, 0, 0, 0, 0, 0, bytes(RING_BYTES // LARGEST_PUBLISHED_SHARE))
    kept.writer.append(Event.TICK, 6)
    whole, key, large, published, tick = read_history(kept.image()).records
    assert (whole.data, whole.size) == (None, RING_BYTES)
    assert key.data == bytes(RING_BYTES // LARGEST_SHARE), "one large message is kept, for the others"
    assert (large.data, large.size, large.time_ns) == (None, RING_BYTES // LARGEST_SHARE, 5)
    assert published.data is None
    assert (tick.kind, tick.data) == (Event.TICK, b"")


@pytest.mark.parametrize("native", BOTH)
def test_large_message_is_kept_again_when_the_one_before_is_overwritten(native: Native | None) -> None:
    kept = Kept(native)
    for number in range(400):
        kept.writer.append(
            Event.MESSAGE, 0, 0, 0, 0, 0, bytes(RING_BYTES // LARGEST_SHARE if number % 9 else 1)
        )
    found = read_history(kept.image())
    assert len([one for one in found.records if one.size > 1 and one.data is not None]) == 1


@pytest.fixture
def segment() -> Iterator[Segment]:
    """A history of which only the beginning has its memory."""
    make_folder(RUN)
    name, words = names.history(RUN, 1, 1), history_words(1 << 20)
    made = Segment.create(name, words, SegmentKind.HISTORY, at_first_bytes=AT_FIRST_BYTES)
    yield made
    made.close()
    remove_names(RUN)


@GROWS
@pytest.mark.parametrize("native", BOTH)
def test_ring_takes_its_memory_as_it_is_needed(segment: Segment, native: Native | None) -> None:
    history = OwnHistory(segment, native)
    at_first = taken_bytes(segment)
    assert at_first < 1 << 18
    for number in range(3000):  # without a break
        history.append(Event.MESSAGE, number, 0, 0, 0, 0, bytes(100))
    found = read_history(image(segment))
    assert (len(found.records), found.is_whole, found.damage) == (3000, True, "")
    assert at_first < taken_bytes(segment) < segment.size * 3 // 4
    for number in range(9000):
        history.append(Event.MESSAGE, number, 0, 0, 0, 0, bytes(100))
    found = read_history(image(segment))
    assert (found.is_whole, found.damage, found.records[-1].number) == (False, "", 12_000)
    assert len(found.records) > (1 << 20) / 170
    history.close()


@GROWS
@pytest.mark.parametrize("native", BOTH)
def test_ring_that_is_prepared_causes_no_page_fault(segment: Segment, native: Native | None) -> None:
    history = OwnHistory(segment, native)
    data, faults = bytes(100), 0
    for number in range(4000):
        before = getrusage(RUSAGE_THREAD).ru_minflt
        history.append(Event.MESSAGE, number, 0, 0, 0, 0, data)
        faults += getrusage(RUSAGE_THREAD).ru_minflt - before
        history.prepare()
    assert faults < 4000 * 170 / PAGESIZE / 4, "it touched most pages itself"
    history.close()


@GROWS
@pytest.mark.parametrize("native", BOTH)
def test_ring_does_not_grow_into_the_last_of_the_memory(
    segment: Segment, native: Native | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if native is not None:
        pytest.skip("what C asks the system cannot be replaced")
    monkeypatch.setattr(transport_history, "free_bytes", lambda: 1 << 20)
    history = OwnHistory(segment, native)
    for number in range(3000):
        history.append(Event.MESSAGE, number, 0, 0, 0, 0, bytes(100))
    found = read_history(image(segment))
    assert (found.is_whole, found.damage, found.records[-1].number) == (False, "", 3000)
    history.close()


@pytest.mark.skipif(NATIVE is None, reason="there is no C")
@given(EVENTS)
def test_both_writers_write_the_same(events: list[tuple[int, bytes]]) -> None:
    in_c, in_python = Kept(NATIVE), Kept(None)
    for kept in (in_c, in_python):
        for number, (kind, data) in enumerate(events):
            kept.writer.append(kind, number, 7, 0, -1, 2, data)
    assert in_c.image() == in_python.image()


@pytest.mark.parametrize("native", BOTH)
def test_disowned_history_records_nothing(native: Native | None) -> None:
    kept = Kept(native)
    kept.writer.disown()
    kept.writer.append(Event.TICK)
    assert read_history(kept.image()).records == []


@given(
    st.lists(st.tuples(st.integers(0, history_words(RING_BYTES) - 1), st.integers(0, 2**64 - 1)), max_size=9)
)
@example([(layout.HISTORY_TAIL, 2**64 - 1)])
@example([(layout.HISTORY_RING, 0)])
@example([(layout.HISTORY_START_BYTES, 2**63)])
def test_any_bytes_are_read_without_an_error(changes: list[tuple[int, int]]) -> None:
    kept = Kept(None)
    for number in range(300):
        kept.writer.append(Event.CLOCK, number, 0, 1)
    for word, value in changes:
        kept.memory[word] = value
    read_history(kept.image())
    read_history(kept.image()[: (changes or [(0, 0)])[0][0]])


@pytest.mark.parametrize("native", BOTH)
def test_writer_survives_what_its_module_did_to_its_memory(native: Native | None) -> None:
    kept = Kept(native)
    for number in range(300):
        kept.writer.append(Event.CLOCK, number, 0, 1)
    for word in range(layout.HISTORY_RING, len(kept.memory)):
        kept.memory[word] = 2**63 + word
    for number in range(300):
        kept.writer.append(Event.MESSAGE, number, 0, 1, 2, 3, bytes(200))
    assert len(read_history(kept.image()).records) > 10
