"""Dynamixel protocol 1.0, with the examples of the maker's manual."""

import pytest

from robbie_robots.hw.dynamixel import protocol1 as protocol
from robbie_robots.hw.dynamixel.protocol1 import Packet1, Protocol1Framing, ServoError
from robbie_robots.hw.framing import FrameDecoder


def decoded(data: bytes) -> list[Packet1]:
    return FrameDecoder(Protocol1Framing()).feed(data)


@pytest.mark.parametrize(
    ("ours", "expected"),
    [
        (protocol.packet(1, 1), "FF FF 01 02 01 FB"),
        (protocol.read(1, 0x2B, 1), "FF FF 01 04 02 2B 01 CC"),
        (protocol.packet(0xFE, 3, b"\x03\x01"), "FF FF FE 04 03 03 01 F6"),
        (
            protocol.sync_write(0x1E, {0: bytes.fromhex("10 00 50 01"), 1: bytes.fromhex("20 02 60 03")}),
            "FF FF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67",
        ),
    ],
)
def test_packets_have_the_bytes_of_the_manual_both_ways(ours: bytes, expected: str) -> None:
    assert ours == bytes.fromhex(expected)
    (packet,) = decoded(ours)
    assert protocol.packet(*packet) == ours


def test_answers_of_the_manual_are_decoded() -> None:
    assert decoded(bytes.fromhex("FF FF 01 02 00 FC")) == [Packet1(1, 0, b"")]
    assert decoded(bytes.fromhex("FF FF 01 03 00 20 DB")) == [Packet1(1, 0, b" ")]
    (packet,) = decoded(bytes.fromhex("FF FF 01 02 24 D8"))
    assert ServoError(packet.code) == ServoError.OVERLOADED | ServoError.OVERHEATED


def test_header_with_one_byte_too_many_is_found() -> None:
    assert decoded(b"\xff" + protocol.packet(1, 1)) == [Packet1(1, 1, b"")]


def test_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="the same number of bytes"):
        protocol.sync_write(0x1E, {0: b"ab", 1: b"c"})
