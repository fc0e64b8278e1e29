"""Dynamixel protocol 2.0, of X, P and newer MX servos.

Source: Robotis, Dynamixel Protocol 2.0 (e-Manual).
"""

import struct
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
# A longer packet does not fit the servos' own buffers.
MAX_PACKET_BYTES = 1_024
_STATUS, _SYNC_READ, _SYNC_WRITE = 0x55, 0x82, 0x83
_STUFFED = b"\xff\xff\xfd"
ALERT = 0x80


class Packet2(NamedTuple):
    """A packet: the servo's number, the instruction, and the parameters without stuffing."""

    servo: int
    instruction: int
    parameters: bytes


class Status(NamedTuple):
    """A servo's answer.

    Attributes:
        servo: its number.
        alert: whether the servo's own error register is set: read it to learn why.
        error: why it refuses the command.
        data: what it answers.
    """

    servo: int
    alert: bool
    error: int
    data: bytes


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x8005 if value & 0x8000 else value << 1) & 0xFFFF
        table.append(value)
    return tuple(table)


_CRC_TABLE = _crc_table()


def crc(data: bytes) -> int:
    """Return the CRC-16 (polynomial 8005 hex, not reflected, start 0)."""
    value = 0
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _CRC_TABLE[value >> 8 ^ byte]
    return value


def packet(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return a packet's bytes.

    Raises:
        ValueError: the parameters are too long, or there is no such servo.
    """
    contents = (bytes([instruction]) + parameters).replace(_STUFFED, _STUFFED + b"\xfd")
    whole = HEADER + struct.pack("<BH", servo, len(contents) + 2) + contents
    if len(whole) + 2 > MAX_PACKET_BYTES or servo in (0xFD, 0xFF):
        raise ValueError(f"no packet to servo {servo} with {len(parameters)} parameters")
    return whole + struct.pack("<H", crc(whole))


def sync_read(address: int, length: int, servos: Sequence[int]) -> bytes:
    """Return the question for the same bytes of several servos; each answers, in this order."""
    return packet(BROADCAST, _SYNC_READ, struct.pack("<HH", address, length) + bytes(servos))


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Return the command to write to several servos at once; each gets as many bytes.

    Raises:
        ValueError: the lengths differ, or there is no servo.
    """
    lengths = {len(values) for values in data.values()}
    if len(lengths) != 1:
        raise ValueError(f"all servos need the same number of bytes, not {sorted(lengths)}")
    parameters = struct.pack("<HH", address, lengths.pop())
    for servo, values in data.items():
        parameters += bytes([servo]) + values
    return packet(BROADCAST, _SYNC_WRITE, parameters)


class Protocol2Framing(Framing[Packet2]):
    """The packets of both directions."""

    start = HEADER
    head_bytes = 7

    def length(self, head: bytes) -> int | None:
        """Return the length that the head tells."""
        if len(head) < 7:
            return None
        rest = head[5] | head[6] << 8
        if not 3 <= rest <= MAX_PACKET_BYTES - 7:
            raise DamagedFrame(f"a packet of {rest} bytes")
        return 7 + rest

    def parse(self, frame: bytes) -> Packet2:
        """Return the packet."""
        (told,) = struct.unpack("<H", frame[-2:])
        if crc(frame[:-2]) != told:
            raise DamagedFrame("wrong CRC")
        contents = frame[7:-2].replace(_STUFFED + b"\xfd", _STUFFED)
        return Packet2(frame[4], contents[0], contents[1:])


def status(sent: Packet2) -> Status:
    """Return the contents of a servo's answer.

    Raises:
        DamagedFrame: it is no answer.
    """
    if sent.instruction != _STATUS or not sent.parameters:
        raise DamagedFrame(f"instruction {sent.instruction:02X} is no answer")
    error = sent.parameters[0]
    return Status(sent.servo, bool(error & ALERT), error & ~ALERT, sent.parameters[1:])
