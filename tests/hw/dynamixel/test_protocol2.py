"""Dynamixel protocol 2.0, with the examples of the maker's manual and as its own library writes packets."""

import dynamixel_sdk
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.dynamixel import protocol2 as protocol
from robbie_robots.hw.dynamixel.protocol2 import Packet2, Protocol2Framing, Status
from robbie_robots.hw.framing import DamagedFrame, FrameDecoder


def decoded(data: bytes) -> list[Packet2]:
    return FrameDecoder(Protocol2Framing()).feed(data)


@pytest.mark.parametrize(
    ("ours", "expected"),
    [
        (protocol.packet(1, 1), "FF FF FD 00 01 03 00 01 19 4E"),
        (protocol.packet(0xFE, 1), "FF FF FD 00 FE 03 00 01 31 42"),
        (protocol.packet(1, 2, bytes.fromhex("84 00 04 00")), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
        (
            protocol.packet(1, 3, bytes.fromhex("74 00 00 02 00 00")),
            "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
        ),
        (
            protocol.packet(1, 3, bytes.fromhex("74 00 FF FF FD 00")),
            "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7",
        ),
    ],
)
def test_packets_have_the_bytes_of_the_manual_both_ways(ours: bytes, expected: str) -> None:
    assert ours == bytes.fromhex(expected)
    (packet,) = decoded(ours)
    assert protocol.packet(*packet) == ours


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D", Status(1, False, 0, bytes.fromhex("06 04 26"))),
        ("FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D", Status(2, False, 0, bytes.fromhex("06 04 26"))),
        ("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0", Status(1, False, 0, bytes.fromhex("A6 00 00 00"))),
    ],
)
def test_answers_of_the_manual_are_decoded(data: str, expected: Status) -> None:
    (packet,) = decoded(bytes.fromhex(data))
    assert protocol.status(packet) == expected


def test_alert_is_told_apart_from_the_error() -> None:
    assert protocol.status(Packet2(1, 0x55, b"\x86")) == Status(1, True, 6, b"")
    with pytest.raises(DamagedFrame, match="no answer"):
        protocol.status(Packet2(1, 0x01, b""))


def makers_packet(servo: int, address: int, data: bytes) -> bytes:
    """Return the packet as the maker's library stuffs it, with its CRC.

    Its `txPacket` forgets what `addStuffing` returns, so a packet is taken from the two parts instead.
    """
    handler = dynamixel_sdk.Protocol2PacketHandler()
    length = len(data) + 5
    head = [0xFF, 0xFF, 0xFD, 0, servo, length & 0xFF, length >> 8, 3]
    stuffed = handler.addStuffing([*head, *address.to_bytes(2, "little"), *data, 0, 0])
    crc: int = handler.updateCRC(0, stuffed, len(stuffed) - 2)
    return bytes(stuffed[:-2]) + crc.to_bytes(2, "little")


# Many of the bytes that need stuffing.
awkward = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55]), min_size=1, max_size=40).map(bytes)


@given(awkward, st.integers(0, 252), st.integers(0, 1000))
def test_packets_are_those_of_the_makers_library(data: bytes, servo: int, address: int) -> None:
    ours = protocol.packet(servo, 3, address.to_bytes(2, "little") + data)
    assert ours == makers_packet(servo, address, data)
    (packet,) = decoded(ours)
    assert packet.parameters == address.to_bytes(2, "little") + data


def test_several_servos_are_read_and_written_at_once() -> None:
    (packet,) = decoded(protocol.sync_read(132, 4, [1, 2]))
    assert packet == Packet2(0xFE, 0x82, bytes.fromhex("84 00 04 00 01 02"))
    (packet,) = decoded(protocol.sync_write(116, {1: b"\1\0\0\0", 2: b"\2\0\0\0"}))
    assert packet == Packet2(0xFE, 0x83, bytes.fromhex("74 00 04 00 01 01 00 00 00 02 02 00 00 00"))
    with pytest.raises(ValueError, match="the same number of bytes"):
        protocol.sync_write(116, {})
