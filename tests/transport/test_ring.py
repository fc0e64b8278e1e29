from array import array

import pytest

from robbie_mp.transport.ring import (
    NumberRingReader,
    NumberRingWriter,
    RingCorrupt,
    RingPlace,
    RingReader,
    RingWriter,
)

CAPACITY = 8


def place() -> RingPlace:
    return RingPlace(array("Q", bytes(8 * 100)), 0, 2, CAPACITY, array("Q", bytes(8)), 0)


def test_records_come_out_as_they_went_in_round_and_round() -> None:
    at = place()
    writer, reader = RingWriter(at), RingReader(at)
    seen = []
    for value in range(50):
        writer.push(value, 1, 2, 3, 4, 5, 2**64 - 1)
        if value % 3 == 2:
            for _ in range(reader.waiting()):
                seen.append(reader.peek()[:7])
                reader.take()
    assert seen == [(value, 1, 2, 3, 4, 5, 2**64 - 1) for value in range(48)]


def test_room_shrinks_until_the_reader_takes() -> None:
    at = place()
    writer, reader = RingWriter(at), RingReader(at)
    for _ in range(CAPACITY):
        writer.push(0, 0, 0, 0, 0, 0, 0)
    assert writer.room() == 0
    assert reader.waiting() == CAPACITY
    reader.take()
    assert writer.room() == 1


def test_new_ends_go_on_where_the_old_ones_stopped() -> None:
    at = place()
    RingWriter(at).push(1, 0, 0, 0, 0, 0, 0)
    first = RingReader(at)
    assert first.waiting() == 1
    first.take()
    RingWriter(at).push(2, 0, 0, 0, 0, 0, 0)
    second = RingReader(at)
    assert second.waiting() == 1
    assert second.peek()[0] == 2


@pytest.mark.parametrize("head", [CAPACITY + 1, 2**63, 2**64 - 1])
def test_impossible_head_is_noticed(head: int) -> None:
    at = place()
    at.words[0] = head
    with pytest.raises(RingCorrupt):
        RingReader(at).waiting()


def test_head_that_goes_back_is_noticed() -> None:
    at = place()
    writer, reader = RingWriter(at), RingReader(at)
    writer.push(0, 0, 0, 0, 0, 0, 0)
    assert reader.waiting() == 1
    reader.take()
    at.words[0] = 0
    with pytest.raises(RingCorrupt):
        reader.waiting()


def test_record_without_its_number_is_noticed() -> None:
    at = place()
    at.words[0] = 1
    reader = RingReader(at)
    assert reader.waiting() == 1
    with pytest.raises(RingCorrupt, match="record 0"):
        reader.peek()


def test_numbers_come_out_in_order_round_and_round() -> None:
    at = place()
    writer, reader = NumberRingWriter(at), NumberRingReader(at)
    seen = []
    for number in range(50):
        writer.push(number)
        if number % CAPACITY == CAPACITY - 1:
            seen += reader.take_all()
    assert seen == list(range(48))
    assert reader.take_all() == [48, 49]
    assert reader.take_all() == []
