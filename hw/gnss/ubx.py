"""UBX, the binary protocol of u-blox receivers.

Source: u-blox AG, u-blox 8 / u-blox M8 Receiver Description including protocol specification (UBX-13003221).
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

MAX_PAYLOAD_BYTES = 8_192


class UbxMessage(NamedTuple):
    """A message: its class, its number in the class, and its payload."""

    message_class: int
    number: int
    payload: bytes


class FixType(IntEnum):
    """How the receiver found its position."""

    NONE = 0
    DEAD_RECKONING = 1
    TWO_D = 2
    THREE_D = 3
    COMBINED = 4
    TIME_ONLY = 5


@dataclass(frozen=True)
class NavigationSolution:
    """Position, speed and time (UBX-NAV-PVT).

    Attributes:
        time_of_week_s: GPS time of week.
        fix_type: how the position was found.
        valid: whether it is within the receiver's limits of accuracy.
        is_corrected: whether corrections of a reference station are in it.
        satellites: number of satellites used.
        latitude_deg: positive to the north.
        longitude_deg: positive to the east.
        height_m: above the WGS 84 ellipsoid.
        altitude_m: above mean sea level.
        horizontal_accuracy_m: estimated by the receiver.
        vertical_accuracy_m: likewise.
        velocity_m_per_s: to the north, to the east, down.
        ground_speed_m_per_s: over ground.
        course_deg: clockwise from true north.
    """

    time_of_week_s: float
    fix_type: FixType
    valid: bool
    is_corrected: bool
    satellites: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    altitude_m: float
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    velocity_m_per_s: tuple[float, float, float]
    ground_speed_m_per_s: float
    course_deg: float


def checksum(data: bytes) -> bytes:
    """Return the checksum of Fletcher over bytes, as in the message."""
    first = second = 0
    for byte in data:
        first += byte
        second += first
    return bytes([first & 0xFF, second & 0xFF])


def message(message_class: int, number: int, payload: bytes = b"") -> bytes:
    """Return a message's bytes.

    Raises:
        ValueError: the payload is too long.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(f"a payload has at most {MAX_PAYLOAD_BYTES} bytes, not {len(payload)}")
    body = struct.pack("<BBH", message_class, number, len(payload)) + payload
    return b"\xb5\x62" + body + checksum(body)


def set_rate(period_ms: int) -> bytes:
    """Return the command for one solution in each period, in GPS time."""
    return message(0x06, 0x08, struct.pack("<HHH", period_ms, 1, 0) if period_ms else b"")


def enable_message(message_class: int, number: int, rate: int = 1) -> bytes:
    """Return the command to send a message with every `rate`-th solution; 0: never."""
    return message(0x06, 0x01, bytes([message_class, number, rate]))


class UbxFraming(Framing[UbxMessage]):
    """The messages of both directions."""

    start = b"\xb5\x62"
    head_bytes = 6

    def length(self, head: bytes) -> int | None:
        """Return the length that the head tells."""
        if len(head) < 6:
            return None
        payload_bytes = head[4] | head[5] << 8
        if payload_bytes > MAX_PAYLOAD_BYTES:
            raise DamagedFrame(f"a payload of {payload_bytes} bytes")
        return 8 + payload_bytes

    def parse(self, frame: bytes) -> UbxMessage:
        """Return the message."""
        if checksum(frame[2:-2]) != frame[-2:]:
            raise DamagedFrame("wrong checksum")
        return UbxMessage(frame[2], frame[3], frame[6:-2])


_PVT = struct.Struct("<I 16x BBxB ii ii II iii i i")
_INVALID_AT, _INVALID_PLACE = 78, 1
"""Flag that latitude, longitude and height are invalid; receivers before protocol 27 do not have it."""
_PVT_BYTES = (84, 92)


def navigation_solution(sent: UbxMessage) -> NavigationSolution:
    """Return what a NAV-PVT message tells.

    Raises:
        DamagedFrame: it is another message, or its position is not on the earth.
    """
    if (sent.message_class, sent.number) != (0x01, 0x07) or len(sent.payload) not in _PVT_BYTES:
        raise DamagedFrame(
            f"message {sent.message_class:02X} {sent.number:02X} of {len(sent.payload)} bytes is no NAV-PVT"
        )
    (
        time_ms,
        fix,
        flags,
        satellites,
        longitude,
        latitude,
        height,
        altitude,
        horizontal,
        vertical,
        north,
        east,
        down,
        speed,
        course,
    ) = _PVT.unpack_from(sent.payload)
    if fix not in FixType._value2member_map_:
        raise DamagedFrame(f"unknown fix type {fix}")
    is_valid = bool(flags & 1) and not sent.payload[_INVALID_AT] & _INVALID_PLACE
    if is_valid and (abs(latitude) > 90 * 10**7 or abs(longitude) > 180 * 10**7):
        raise DamagedFrame(f"latitude {latitude / 1e7:g}, longitude {longitude / 1e7:g} degrees")
    return NavigationSolution(
        time_of_week_s=time_ms / 1e3,
        fix_type=FixType(fix),
        valid=is_valid,
        is_corrected=bool(flags & 2),
        satellites=satellites,
        latitude_deg=latitude / 1e7,
        longitude_deg=longitude / 1e7,
        height_m=height / 1e3,
        altitude_m=altitude / 1e3,
        horizontal_accuracy_m=horizontal / 1e3,
        vertical_accuracy_m=vertical / 1e3,
        velocity_m_per_s=(north / 1e3, east / 1e3, down / 1e3),
        ground_speed_m_per_s=speed / 1e3,
        course_deg=course / 1e5,
    )
