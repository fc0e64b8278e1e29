"""MIP, the protocol of MicroStrain's inertial units from the 3DM-GX3-25 on.

Source: LORD MicroStrain, 3DM-GX5-25 Data Communications Protocol.
"""

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from itertools import accumulate
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

STANDARD_GRAVITY_M_PER_S2 = 9.80665
REPLY = 0xF1


class DescriptorSet(IntEnum):
    """The subject of a packet."""

    BASE = 0x01
    SETTINGS = 0x0C
    SENSOR_DATA = 0x80
    GNSS_DATA = 0x81
    FILTER_DATA = 0x82


class SensorField(IntEnum):
    """The fields of sensor data that this driver uses."""

    ACCELERATION = 0x04
    TURN_RATE = 0x05
    MAGNETIC_FIELD = 0x06
    QUATERNION = 0x0A
    EULER = 0x0C
    GPS_TIME = 0x12
    REFERENCE_TIME = 0xD5


# Numbers in each field: their format as in `struct`, big-endian.
_FORMATS: dict[int, struct.Struct] = {
    SensorField.ACCELERATION: struct.Struct(">3f"),
    SensorField.TURN_RATE: struct.Struct(">3f"),
    SensorField.MAGNETIC_FIELD: struct.Struct(">3f"),
    SensorField.QUATERNION: struct.Struct(">4f"),
    SensorField.EULER: struct.Struct(">3f"),
    # Time of the week in s, week, validity.
    SensorField.GPS_TIME: struct.Struct(">dHH"),
    # ns since the unit was switched on.
    SensorField.REFERENCE_TIME: struct.Struct(">Q"),
}
# Looking a field up here is much quicker than `SensorField(descriptor)`.
_LAYOUTS = {int(field): (SensorField(field), layout) for field, layout in _FORMATS.items()}
_BASE_RATE, _BASE_RATE_REPLY = 0x06, 0x83


class MipField(NamedTuple):
    """One field of a packet: its descriptor, and its data."""

    descriptor: int
    data: bytes


class MipPacket(NamedTuple):
    """A packet: what it is about, and its fields one after the other, each with its length and descriptor."""

    descriptor_set: int
    payload: bytes

    @property
    def fields(self) -> tuple[MipField, ...]:
        """Return the fields."""
        payload = self.payload
        return tuple(
            MipField(payload[begin + 1], payload[begin + 2 : begin + payload[begin]])
            for begin in _beginnings(payload)
        )


class MipReply(NamedTuple):
    """A unit's answer to a command; error 0: done."""

    command: int
    error: int


def checksum(data: bytes) -> bytes:
    """Return the checksum of Fletcher over bytes, as in the packet."""
    return bytes([sum(data) & 0xFF, sum(accumulate(data)) & 0xFF])


def packet(descriptor_set: int, fields: Sequence[MipField]) -> bytes:
    """Return a packet's bytes.

    Raises:
        ValueError: the fields are too long.
    """
    payload = b"".join(bytes([2 + len(field.data), field.descriptor]) + field.data for field in fields)
    body = b"\x75\x65" + bytes([descriptor_set, len(payload)]) + payload
    return body + checksum(body)


def set_idle() -> bytes:
    """Return the command that stops the unit's stream."""
    return packet(DescriptorSet.BASE, [MipField(0x02, b"")])


def resume() -> bytes:
    """Return the command that starts the stream again."""
    return packet(DescriptorSet.BASE, [MipField(0x06, b"")])


def base_rate_question() -> bytes:
    """Return the question for the rate at which the unit measures."""
    return packet(DescriptorSet.SETTINGS, [MipField(_BASE_RATE, b"")])


def base_rate_hz(sent: MipPacket) -> int | None:
    """Return the rate that a packet tells in answer to `base_rate_question`; None: it tells none."""
    for field in sent.fields:
        if field.descriptor == _BASE_RATE_REPLY and len(field.data) == 2:
            return field.data[0] << 8 | field.data[1]
    return None


def sensor_format(fields: Sequence[tuple[int, int]]) -> bytes:
    """Return the command that chooses the fields of sensor data.

    Args:
        fields: pairs of a descriptor and a divisor of the unit's base rate.
    """
    data = bytes([1, len(fields)]) + b"".join(struct.pack(">BH", *field) for field in fields)
    return packet(DescriptorSet.SETTINGS, [MipField(0x08, data)])


def enable_sensor_stream() -> bytes:
    """Return the command that has the unit send sensor data."""
    return packet(DescriptorSet.SETTINGS, [MipField(0x11, b"\x01\x01\x01")])


class MipFraming(Framing[MipPacket]):
    """The packets of both directions."""

    start = b"\x75\x65"
    head_bytes = 4

    def length(self, head: bytes) -> int | None:
        """Return the length that the fourth byte tells."""
        return 6 + head[3] if len(head) == 4 else None

    def parse(self, frame: bytes) -> MipPacket:
        """Return the packet's fields."""
        if checksum(frame[:-2]) != frame[-2:]:
            raise DamagedFrame("wrong checksum")
        payload = frame[4:-2]
        _beginnings(payload)
        return MipPacket(frame[2], payload)


def _beginnings(payload: bytes) -> list[int]:
    """Return where the fields of a payload begin.

    Raises:
        DamagedFrame: their lengths do not fit.
    """
    found, position, end = [], 0, len(payload)
    while position < end:
        length = payload[position]
        if length < 2 or position + length > end:
            raise DamagedFrame(f"a field of {length} bytes with {end - position} left")
        found.append(position)
        position += length
    return found


def sensor_values(sent: MipPacket) -> dict[SensorField, tuple[float, ...]]:
    """Return the numbers of a packet of sensor data; acceleration is in g, as the unit sends it.

    A field with a number that is not finite is left out: the unit does not know it.

    Raises:
        DamagedFrame: a field has another length.
    """
    values: dict[SensorField, tuple[float, ...]] = {}
    if sent.descriptor_set != DescriptorSet.SENSOR_DATA:
        return values
    payload, position = sent.payload, 0
    # Hundreds of times a second: without the detour over `fields`. `parse` has checked the lengths.
    while position < len(payload):
        length = payload[position]
        if known := _LAYOUTS.get(payload[position + 1]):
            field, layout = known
            if length - 2 != layout.size:
                raise DamagedFrame(f"field {payload[position + 1]:02X} has {length - 2} bytes")
            numbers = layout.unpack_from(payload, position + 2)
            if math.isfinite(sum(numbers)):
                values[field] = numbers
        position += length
    return values


def replies(sent: MipPacket) -> list[MipReply]:
    """Return the answers in a packet."""
    return [
        MipReply(*field.data[:2])
        for field in sent.fields
        if field.descriptor == REPLY and len(field.data) >= 2
    ]
