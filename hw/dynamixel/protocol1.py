"""Dynamixel protocol 1.0, of AX, RX, EX and older MX servos.

Source: Robotis, Dynamixel Protocol 1.0 (e-Manual).
"""

from collections.abc import Mapping
from enum import IntFlag
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

BROADCAST = 0xFE
_READ, _SYNC_WRITE = 2, 0x83


class ServoError(IntFlag):
    """The errors that a servo reports with every answer."""

    VOLTAGE = 1
    ANGLE_LIMIT = 2
    OVERHEATED = 4
    RANGE = 8
    CHECKSUM = 16
    OVERLOADED = 32
    INSTRUCTION = 64


class Packet1(NamedTuple):
    """A packet: the servo's number; its instruction or, in an answer, its errors; and the parameters."""

    servo: int
    code: int
    parameters: bytes


def checksum(data: bytes) -> int:
    """Return the inverted sum of the bytes from the servo's number on."""
    return ~sum(data) & 0xFF


def packet(servo: int, code: int, parameters: bytes = b"") -> bytes:
    """Return a packet's bytes.

    Raises:
        ValueError: the parameters are too long, or there is no such servo.
    """
    if len(parameters) > 253 or not 0 <= servo <= BROADCAST:
        raise ValueError(f"no packet to servo {servo} with {len(parameters)} parameters")
    body = bytes([servo, len(parameters) + 2, code]) + parameters
    return b"\xff\xff" + body + bytes([checksum(body)])


def read(servo: int, address: int, length: int) -> bytes:
    """Return the question for `length` bytes of a servo's table."""
    return packet(servo, _READ, bytes([address, length]))


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Return the command to write to several servos at once; each gets as many bytes.

    Raises:
        ValueError: the lengths differ, or there is no servo.
    """
    length = _common_length(data)
    parameters = bytes([address, length])
    for servo, values in data.items():
        parameters += bytes([servo]) + values
    return packet(BROADCAST, _SYNC_WRITE, parameters)


class Protocol1Framing(Framing[Packet1]):
    """The packets of both directions."""

    start = b"\xff\xff"
    head_bytes = 4

    def length(self, head: bytes) -> int | None:
        """Return the length that the fourth byte tells."""
        if len(head) > 2 and head[2] == 0xFF:
            raise DamagedFrame("no servo has the number 255")
        if len(head) < 4:
            return None
        if head[3] < 2:
            raise DamagedFrame(f"a packet of {head[3]} bytes")
        return 4 + head[3]

    def parse(self, frame: bytes) -> Packet1:
        """Return the packet."""
        if checksum(frame[2:-1]) != frame[-1]:
            raise DamagedFrame("wrong checksum")
        return Packet1(frame[2], frame[4], frame[5:-1])


def _common_length(data: Mapping[int, bytes]) -> int:
    lengths = {len(values) for values in data.values()}
    if len(lengths) != 1:
        raise ValueError(f"all servos need the same number of bytes, not {sorted(lengths)}")
    return lengths.pop()
