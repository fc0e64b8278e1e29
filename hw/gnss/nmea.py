"""Sentences of NMEA 0183, as receivers of satellite navigation send them.

Source: National Marine Electronics Association, NMEA 0183 Standard for Interfacing Marine Electronic
Devices; u-blox AG, u-blox 8 Receiver Description (UBX-13003221), section NMEA Protocol; NovAtel, OEM7
Commands and Logs Reference Manual, log GPGGA, for quality 9.
"""

import math
import re
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

KNOT_M_PER_S = 1852 / 3600
# The standard allows 82 characters; receivers send longer ones.
MAX_SENTENCE_BYTES = 1_024
_SENTENCE = re.compile(rb"[!$]([A-Z0-9]{2,}),([ -~]*)\*([0-9A-Fa-f]{2})\r?\n?")
_POSITION = re.compile(r"(\d{2,3})(\d{2}(?:\.\d*)?)", re.ASCII)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)", re.ASCII)


class Sentence(NamedTuple):
    """A sentence: talker (such as "GN"; "" for the maker's own sentences), type (such as "GGA"), fields."""

    talker: str
    kind: str
    fields: tuple[str, ...]


NO_DILUTION = 99.0
"""A dilution of precision from this value on means that it is unknown."""


class FixQuality(IntEnum):
    """How a receiver found its position."""

    NONE = 0
    SATELLITES = 1
    DIFFERENTIAL = 2
    PRECISE = 3
    RTK_FIXED = 4
    RTK_FLOAT = 5
    DEAD_RECKONING = 6
    """Estimated from older positions and the motion since."""
    MANUAL = 7
    """Typed in."""
    SIMULATION = 8
    """Made up by the receiver, to test the devices that use it."""
    SBAS = 9
    """With corrections from satellites (WAAS, EGNOS), as NovAtel's receivers report; others use 2."""

    @property
    def is_measured(self) -> bool:
        """Whether the position comes from satellites now."""
        return self in MEASURED

    @property
    def is_corrected(self) -> bool:
        """Whether corrections of a reference station are in it."""
        return self in CORRECTED


CORRECTED = (FixQuality.DIFFERENTIAL, FixQuality.RTK_FIXED, FixQuality.RTK_FLOAT, FixQuality.SBAS)
MEASURED = (FixQuality.SATELLITES, FixQuality.PRECISE, *CORRECTED)


@dataclass(frozen=True)
class PositionFix:
    """A GGA sentence; a value that the receiver does not know is NaN.

    Attributes:
        time_of_day_s: UTC, seconds since midnight.
        latitude_deg: positive to the north.
        longitude_deg: positive to the east.
        quality: how the position was found.
        satellites: number of satellites used.
        horizontal_dilution: of precision.
        altitude_m: above mean sea level.
        geoid_m: height of mean sea level above the WGS 84 ellipsoid.
    """

    time_of_day_s: float
    latitude_deg: float
    longitude_deg: float
    quality: FixQuality
    satellites: int
    horizontal_dilution: float
    altitude_m: float
    geoid_m: float


@dataclass(frozen=True)
class RmcSentence:
    """An RMC sentence; a value that the receiver does not know is NaN.

    Attributes:
        time_of_day_s: UTC, seconds since midnight.
        valid: whether the receiver vouches for the values.
        latitude_deg: positive to the north.
        longitude_deg: positive to the east.
        speed_m_per_s: over ground.
        course_deg: clockwise from true north.
    """

    time_of_day_s: float
    valid: bool
    latitude_deg: float
    longitude_deg: float
    speed_m_per_s: float
    course_deg: float


def checksum(text: bytes) -> int:
    """Return the exclusive or of the characters between the start and the asterisk."""
    total = 0
    for character in text:
        total ^= character
    return total


def sentence(text: str) -> bytes:
    """Return the bytes of a sentence with start and checksum, such as for "GPGGA,184353.07,…"."""
    data = text.encode("ascii")
    return b"$%s*%02X\r\n" % (data, checksum(data))


class NmeaFraming(Framing[Sentence]):
    """Sentences between `$` and the line's end, or, behind a checksum, the next `$`."""

    start = b"$"
    head_bytes = MAX_SENTENCE_BYTES

    def length(self, head: bytes) -> int | None:
        """Return the length up to the line's end."""
        end = head.find(b"\n")
        again = head.find(b"$", 1)
        if again >= 0 and (end < 0 or again < end):
            if b"*" in head[max(0, again - 4) : max(0, again - 2)]:
                return again
            raise DamagedFrame("another sentence begins before the line's end")
        if end < 0 and len(head) == MAX_SENTENCE_BYTES:
            raise DamagedFrame(f"no end of line in {MAX_SENTENCE_BYTES} characters")
        return end + 1 if end >= 0 else None

    def parse(self, frame: bytes) -> Sentence:
        """Return the sentence's fields."""
        match = _SENTENCE.fullmatch(frame)
        if match is None:
            raise DamagedFrame(f"no sentence of NMEA 0183: {frame!r}")
        address, text, told = match.groups()
        if checksum(address + b"," + text) != int(told, 16):
            raise DamagedFrame(f"wrong checksum {told!r}")
        name = address.decode()
        talker, kind = ("", name) if name.startswith("P") else (name[:2], name[2:])
        return Sentence(talker, kind, tuple(text.decode().split(",")))


def position_fix(sent: Sentence) -> PositionFix:
    """Return what a GGA sentence tells.

    Raises:
        DamagedFrame: it is another sentence, or a field is malformed.
    """
    fields = _fields(sent, "GGA", 14)
    quality = _whole(fields[5])
    if quality not in FixQuality._value2member_map_:
        raise DamagedFrame(f"unknown quality {fields[5]!r}")
    return PositionFix(
        time_of_day_s=_time(fields[0]),
        latitude_deg=_angle(fields[1], fields[2], LATITUDE),
        longitude_deg=_angle(fields[3], fields[4], LONGITUDE),
        quality=FixQuality(quality),
        satellites=_whole(fields[6]),
        horizontal_dilution=_dilution(fields[7]),
        altitude_m=_metres(fields[8], fields[9]),
        geoid_m=_metres(fields[10], fields[11]),
    )


def motion(sent: Sentence) -> RmcSentence:
    """Return what an RMC sentence tells.

    Raises:
        DamagedFrame: it is another sentence, or a field is malformed.
    """
    fields = _fields(sent, "RMC", 9)
    return RmcSentence(
        time_of_day_s=_time(fields[0]),
        valid=fields[1] == "A",
        latitude_deg=_angle(fields[2], fields[3], LATITUDE),
        longitude_deg=_angle(fields[4], fields[5], LONGITUDE),
        speed_m_per_s=_number(fields[6]) * KNOT_M_PER_S,
        course_deg=_number(fields[7]),
    )


def _fields(sent: Sentence, kind: str, least: int) -> tuple[str, ...]:
    if sent.kind != kind or len(sent.fields) < least:
        raise DamagedFrame(f"{sent.kind} with {len(sent.fields)} fields is no {kind} sentence")
    return sent.fields


def _number(text: str) -> float:
    if not text:
        return math.nan
    if not _NUMBER.fullmatch(text):
        raise DamagedFrame(f"{text!r} is no number")
    number = float(text)
    if not math.isfinite(number):
        raise DamagedFrame(f"{text!r:.40} is too large")
    return number


def _dilution(text: str) -> float:
    dilution = _number(text)
    if dilution < 0.0:
        raise DamagedFrame(f"a dilution of precision of {text}")
    # 0 would be a position without error; receivers send it when they know none
    return dilution if 0.0 < dilution < NO_DILUTION else math.nan


def _metres(text: str, unit: str) -> float:
    if unit not in ("M", ""):
        raise DamagedFrame(f"{text!r} is in {unit!r}, not in metres")
    return _number(text)


def _whole(text: str) -> int:
    if text and not re.fullmatch("[0-9]{1,9}", text):
        raise DamagedFrame(f"{text!r} is no whole number")
    return int(text or 0)


def _time(text: str) -> float:
    if not text:
        return math.nan
    if not re.fullmatch(r"[0-9]{6}(\.[0-9]*)?", text):
        raise DamagedFrame(f"{text!r} is no time of day")
    hours, minutes, seconds = int(text[:2]), int(text[2:4]), float(text[4:])
    # second 60 is a leap second
    if hours >= 24 or minutes >= 60 or seconds >= 61.0:
        raise DamagedFrame(f"{text!r} is no time of day")
    return hours * 3600 + minutes * 60 + seconds


class _Coordinate(NamedTuple):
    sides: tuple[str, str]
    largest_deg: float


LATITUDE, LONGITUDE = _Coordinate(("N", "S"), 90.0), _Coordinate(("E", "W"), 180.0)


def _angle(text: str, side: str, coordinate: _Coordinate) -> float:
    """Return the angle in degrees of text such as "1929.045" (degrees and minutes)."""
    if not text:
        return math.nan
    match = _POSITION.fullmatch(text)
    if match is None or side not in coordinate.sides or float(match[2]) >= 60.0:
        raise DamagedFrame(f"{text!r:.40} {side!r} is no position")
    degrees = int(match[1]) + float(match[2]) / 60
    if degrees > coordinate.largest_deg:
        raise DamagedFrame(f"{text!r:.40} {side!r} is beyond {coordinate.largest_deg:g} degrees")
    return degrees if side == coordinate.sides[0] else -degrees
