"""The history of a module: what is kept, in C and in Python alike, and what any other bytes read as."""

from array import array

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.history import (
    HEAD_BYTES,
    LARGEST_SHARE,
    Event,
    HistoryWriter,
    PythonHistory,
    history_words,
    read_history,
)
from tests._support.implementations import BOTH, NATIVE, Native

RING_BYTES = 1 << 14
EVENTS = st.lists(st.tuples(st.sampled_from([1, 2, 6]), st.binary(max_size=700)), max_size=80)


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
    kept.writer.append(Event.MESSAGE, 5, 0, 0, 0, 0, bytes(RING_BYTES // LARGEST_SHARE))
    kept.writer.append(Event.TICK, 6)
    large, tick = read_history(kept.image()).records
    assert (large.data, large.size, large.time_ns) == (None, RING_BYTES // LARGEST_SHARE, 5)
    assert (tick.kind, tick.data) == (Event.TICK, b"")


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
