"""The Open Interface (OI) of iRobot's Create 2 and Roomba 600.

Source: iRobot Corporation, iRobot Create 2 Open Interface (OI) Specification based on the iRobot Roomba 600
(2015).
"""

import struct
from collections.abc import Iterable, Sequence
from enum import IntEnum, IntFlag
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

STREAM_HEADER = 0x13
# What the robot can send in the 15 ms between two frames of the stream, at 115,200 baud.
MAX_STREAM_BYTES = 172
MAX_SPEED_MM_PER_S = 500
MAX_SONG_NOTES = 16
# Radius of a straight line, and of turns on the spot.


class OpenInterfaceError(ValueError):
    """A command has a value that the Open Interface does not allow."""


class CreateMode(IntEnum):
    """How far the robot obeys (packet 35)."""

    OFF = 0
    PASSIVE = 1
    SAFE = 2
    FULL = 3


class Bumps(IntFlag):
    """Bumpers and wheel drops (packet 7)."""

    BUMP_RIGHT = 1
    BUMP_LEFT = 2
    WHEEL_DROP_RIGHT = 4
    WHEEL_DROP_LEFT = 8


class Charging(IntEnum):
    """The state of the charger (packet 21)."""

    NOT_CHARGING = 0
    RECONDITIONING = 1
    FULL = 2
    TRICKLE = 3
    WAITING = 4
    FAULT = 5


class Leds(IntFlag):
    """The lamps that are either on or off."""

    DEBRIS = 1
    SPOT = 2
    DOCK = 4
    CHECK_ROBOT = 8


class SensorPacket(NamedTuple):
    """One sensor packet: its name, and its format as in `struct`, big-endian."""

    name: str
    format: str


_NAMES_AND_FORMATS = """
    bumps_and_wheel_drops B; wall B; cliff_left B; cliff_front_left B; cliff_front_right B; cliff_right B;
    virtual_wall B; overcurrents B; dirt B; unused_16 B;
    infrared_omni B; buttons B; distance_mm h; angle_deg h;
    charging_state B; voltage_mv H; current_ma h; temperature_c b; charge_mah H; capacity_mah H;
    wall_signal H; cliff_left_signal H; cliff_front_left_signal H; cliff_front_right_signal H;
    cliff_right_signal H; unused_32 B; unused_33 H; charging_sources B;
    mode B; song_number B; song_playing B; stream_packets B; requested_speed_mm_per_s h;
    requested_radius_mm h; requested_right_mm_per_s h; requested_left_mm_per_s h;
    left_encoder H; right_encoder H;
    light_bumper B; light_bump_left H; light_bump_front_left H; light_bump_center_left H;
    light_bump_center_right H; light_bump_front_right H; light_bump_right H;
    infrared_left B; infrared_right B; left_motor_ma h; right_motor_ma h; main_brush_ma h; side_brush_ma h;
    stasis B
"""
# The packets 7 to 58.
PACKETS = {
    number: SensorPacket(*text.split()) for number, text in enumerate(_NAMES_AND_FORMATS.split(";"), start=7)
}
# Groups of consecutive packets: first and last packet.
GROUPS = {
    0: (7, 26),
    1: (7, 16),
    2: (17, 20),
    3: (21, 26),
    4: (27, 34),
    5: (35, 42),
    6: (7, 42),
    100: (7, 58),
    101: (43, 58),
    106: (46, 51),
    107: (54, 58),
}


def packets_of(number: int) -> tuple[SensorPacket, ...]:
    """Return the packets of a group, or the one packet with this number.

    Raises:
        OpenInterfaceError: there is no such packet or group.
    """
    first, last = GROUPS.get(number, (number, number))
    if first not in PACKETS:
        raise OpenInterfaceError(f"the Open Interface has no sensor packet {number}")
    return tuple(PACKETS[each] for each in range(first, last + 1))


def struct_of(number: int) -> struct.Struct:
    """Return the layout of a packet or group.

    Raises:
        OpenInterfaceError: there is no such packet or group.
    """
    return struct.Struct(">" + "".join(packet.format for packet in packets_of(number)))


def start() -> bytes:
    """Return the command that opens the interface, in passive mode."""
    return b"\x80"


def safe() -> bytes:
    """Return the command for safe mode: the robot stops at cliffs, wheel drops and the charger."""
    return b"\x83"


def seek_dock() -> bytes:
    """Return the command that sends the robot to its dock."""
    return b"\x8f"


def drive_direct(left_mm_per_s: int, right_mm_per_s: int) -> bytes:
    """Return the command to turn each wheel at its own speed.

    Raises:
        OpenInterfaceError: a value is out of range.
    """
    _check("left_mm_per_s", left_mm_per_s, -MAX_SPEED_MM_PER_S, MAX_SPEED_MM_PER_S)
    _check("right_mm_per_s", right_mm_per_s, -MAX_SPEED_MM_PER_S, MAX_SPEED_MM_PER_S)
    # The right wheel comes first.
    return struct.pack(">Bhh", 145, right_mm_per_s, left_mm_per_s)


def leds(lamps: Leds, color: int, intensity: int) -> bytes:
    """Return the command to switch the lamps.

    Args:
        lamps: those that shine.
        color: of the power lamp, from 0 (green) to 255 (red).
        intensity: of the power lamp, 0 to 255.

    Raises:
        OpenInterfaceError: a value is out of range.
    """
    _check("color", color, 0, 255)
    _check("intensity", intensity, 0, 255)
    return bytes([139, int(lamps) & 0x0F, color, intensity])


def song(number: int, notes: Sequence[tuple[int, int]]) -> bytes:
    """Return the command that stores a song.

    Args:
        number: place of the song, 0 to 4.
        notes: 1 to 16 pairs of a MIDI note (31 to 127; any other: a pause) and a duration in 1/64 s.

    Raises:
        OpenInterfaceError: a value is out of range.
    """
    _check("number", number, 0, 4)
    _check("number of notes", len(notes), 1, MAX_SONG_NOTES)
    for note, duration in notes:
        _check("note", note, 0, 255)
        _check("duration", duration, 0, 255)
    return bytes([140, number, len(notes), *(value for note in notes for value in note)])


def play(number: int) -> bytes:
    """Return the command that plays a stored song.

    Raises:
        OpenInterfaceError: the number is out of range.
    """
    _check("number", number, 0, 4)
    return bytes([141, number])


def stream(numbers: Sequence[int]) -> bytes:
    """Return the command that has the robot send these packets or groups every 15 ms.

    Raises:
        OpenInterfaceError: a packet does not exist, or they are too long for 15 ms.
    """
    length = StreamFraming(numbers).bytes_in_all
    _check("bytes of a frame", length, 4, MAX_STREAM_BYTES)
    return bytes([148, len(numbers), *numbers])


def pause_stream() -> bytes:
    """Return the command that pauses the stream."""
    return b"\x96\x00"


def checksum(data: Iterable[int]) -> int:
    """Return the byte that makes the sum of a frame's bytes 0."""
    return -sum(data) & 0xFF


class StreamFraming(Framing[dict[str, int]]):
    """The frames of the stream; each is the values of the requested packets, by name.

    The header may occur in the data too. So a frame counts only if it has exactly the packets requested.

    Args:
        numbers: the requested packets and groups, in order.

    Raises:
        OpenInterfaceError: a packet does not exist.
    """

    start = bytes([STREAM_HEADER])
    head_bytes = 3

    def __init__(self, numbers: Sequence[int]) -> None:
        self._parts = [(number, struct_of(number), packets_of(number)) for number in numbers]
        data_bytes = sum(1 + layout.size for _, layout, _ in self._parts)
        self.bytes_in_all = data_bytes + 3
        self.start = bytes([STREAM_HEADER, data_bytes & 0xFF, *numbers[:1]])

    def length(self, head: bytes) -> int | None:
        """Return the length, which is the same for all frames."""
        return self.bytes_in_all

    def parse(self, frame: bytes) -> dict[str, int]:
        """Return the packets' values by name."""
        if sum(frame) & 0xFF:
            raise DamagedFrame("wrong checksum")
        values: dict[str, int] = {}
        position = 2
        for number, layout, packets in self._parts:
            if frame[position] != number:
                raise DamagedFrame(f"packet {frame[position]} instead of {number}")
            numbers = layout.unpack_from(frame, position + 1)
            values.update(zip((packet.name for packet in packets), numbers, strict=True))
            position += 1 + layout.size
        return values


def _check(name: str, value: int, least: int, most: int) -> None:
    if not least <= value <= most:
        raise OpenInterfaceError(f"{name} must be between {least} and {most}, not {value}")
