"""Packets to and from Pioneer robots."""

import struct

import pytest

from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.pioneer import p2os
from robbie_robots.hw.pioneer.p2os import PioneerCommand

VECTORS = [
    (PioneerCommand.PULSE, None, "FA FB 03 00 00 00"),
    (PioneerCommand.OPEN, None, "FA FB 03 01 00 01"),
    (PioneerCommand.CLOSE, None, "FA FB 03 02 00 02"),
    (PioneerCommand.ENABLE, 1, "FA FB 06 04 3B 01 00 05 3B"),
    (PioneerCommand.SPEED, 200, "FA FB 06 0B 3B C8 00 D3 3B"),
    (PioneerCommand.SPEED, -200, "FA FB 06 0B 1B C8 00 D3 1B"),
    (PioneerCommand.TURN_RATE, 30, "FA FB 06 15 3B 1E 00 33 3B"),
    (PioneerCommand.SONAR, 0, "FA FB 06 1C 3B 00 00 1C 3B"),
    (PioneerCommand.STOP, None, "FA FB 03 1D 00 1D"),
    (PioneerCommand.EMERGENCY_STOP, None, "FA FB 03 37 00 37"),
    (PioneerCommand.CONFIG, 1, "FA FB 06 12 3B 01 00 13 3B"),
]


@pytest.mark.parametrize(("number", "argument", "expected"), VECTORS)
def test_commands_have_the_bytes_of_the_manual(number: int, argument: int | None, expected: str) -> None:
    assert p2os.command(number, argument) == bytes.fromhex(expected)


@pytest.mark.parametrize(("number", "argument", "expected"), VECTORS)
def test_packets_of_the_manual_are_intact(number: int, argument: int | None, expected: str) -> None:
    (packet,) = FrameDecoder(p2os.P2osFraming()).feed(bytes.fromhex(expected))
    assert packet.data == b"" if argument is None else packet.data[1:] == struct.pack("<H", abs(argument))


def standard_packet(end: bytes = b"") -> bytes:
    sonars = bytes([2]) + struct.pack("<BHBH", 3, 1234, 15, 5000)
    start = struct.pack("<HHhhhBBBhHB", 100, 0x7FFF, -1024, 200, -150, 124, 0b101, 0b11, 0, 0b11, 7)
    return p2os.packet(b"\x33" + start + sonars + end)


def test_standard_packet_yields_motion_sonars_bumpers_and_stalls() -> None:
    (packet,) = FrameDecoder(p2os.P2osFraming()).feed(standard_packet())
    told = p2os.server_information(packet)
    assert told.moving
    assert (told.x, told.y, told.heading) == (100, 0x7FFF, -1024)
    assert (told.left_mm_per_s, told.right_mm_per_s) == (200, -150)
    assert told.battery_v == 12.4
    assert (told.left_stalled, told.right_stalled) == (True, True)
    assert (told.rear_bumpers, told.front_bumpers) == (0b10, 0b1)
    assert told.motors_enabled
    assert told.sonar_mm == {3: 1234, 15: 5000}
    assert told.charging is None


def test_longer_standard_packet_yields_the_finer_voltage_and_the_charger() -> None:
    (packet,) = FrameDecoder(p2os.P2osFraming()).feed(
        standard_packet(struct.pack("<BBBBBHB", 0, 0, 0, 0, 0, 247, 2))
    )
    told = p2os.server_information(packet)
    assert (told.battery_v, told.charging) == (24.7, 2)


def test_sonars_that_do_not_fit_the_packet_are_damage() -> None:
    with pytest.raises(DamagedFrame, match="255 sonars do not fit"):
        p2os.server_information(p2os.PioneerPacket(0x32, bytes(18) + b"\xff"))


def test_names_come_with_the_answer_to_the_handshake() -> None:
    answer = p2os.packet(b"\x02Robbie\0Pioneer\0p3at\0")
    (packet,) = FrameDecoder(p2os.P2osFraming()).feed(answer)
    assert p2os.robot_name(packet) == ("Robbie", "Pioneer", "p3at")
    with pytest.raises(DamagedFrame, match="instead of the robot's name"):
        p2os.robot_name(p2os.PioneerPacket(0x32, b"a\0b\0c"))


def test_last_odd_byte_of_a_checksum_is_combined_by_exclusive_or() -> None:
    assert p2os.checksum(bytes.fromhex("04 3B 01")) == 0x043A


def test_arguments_that_do_not_fit_are_refused() -> None:
    with pytest.raises(p2os.P2osError, match="65535"):
        p2os.command(PioneerCommand.SPEED, 70_000)
    with pytest.raises(p2os.P2osError, match="at most 190 bytes"):
        p2os.command(PioneerCommand.DIGITAL_OUT, "x" * 191)
