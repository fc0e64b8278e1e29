"""Hostile datagrams neither fill the memory of a participant nor end its thread."""

import struct

import pytest

from robbie_mp.connect.ros2.rtps import wire
from robbie_mp.connect.ros2.rtps.endpoints import ReliableReader

WRITER = b"\x01\x10" + bytes(10) + b"\0\0\x01\x03"
READER = b"\0\0\x01\x04"
MAX_BYTES = 4096


def _reader() -> ReliableReader:
    reader = ReliableReader(READER, lambda _to, _parts: None, lambda _sample: None, MAX_BYTES)
    reader.match(WRITER)
    return reader


def _part(number: int) -> wire.Sample:
    return wire.Sample(READER, WRITER, 1, {}, bytes(256), number, 256, MAX_BYTES)


def _kept_bytes(reader: ReliableReader) -> int:
    return sum(len(part) for parts in reader.writers[WRITER].partial.values() for part in parts.values())


def test_parts_behind_the_end_of_a_message_are_not_kept() -> None:
    reader = _reader()
    for number in range(1000, 2000):
        reader.on_sample(_part(number))
    assert _kept_bytes(reader) == 0


def test_gap_up_to_the_last_number_is_refused_and_the_reader_still_greets() -> None:
    numbers = struct.pack("<iIiII8I", 0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 256, *[0xFFFFFFFF] * 8)
    body = READER + WRITER[wire.PREFIX_BYTES :] + numbers
    reader = _reader()
    with pytest.raises(wire.Wrong):
        _, writer, start, base, single = wire.gap_of(wire.Submessage(wire.GAP, 1, body, WRITER[:12]))
        reader.on_gap(writer, start, base, single)
    reader.look_after()
