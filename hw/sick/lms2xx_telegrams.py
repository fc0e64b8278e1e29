"""The telegrams of SICK's LMS200, 211, 220, 221 and 291 on RS-232 and RS-422.

Source: SICK AG, Telegrams for Configuring and Operating the LMS2xx Laser Measurement Systems.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.framing import DamagedFrame, Framing

STX = b"\x02"
ACK = b"\x06"
NAK = b"\x15"
HEAD_BYTES = 4
CRC_BYTES = 2
MAX_DATA_BYTES = 812
REPLY_ADDRESSES = (0x80, 0x81)

# Commands, and what the scanner answers to them.
SWITCH_MODE = 0x20
MODE_SWITCHED = 0xA0
SWITCH_VARIANT = 0x3B
VARIANT_SWITCHED = 0xBB
SCAN = 0xB0
POWER_ON = 0x90
REFUSED = 0x92

# What SWITCH_MODE can ask for.
STREAM = 0x24
REQUEST_ONLY = 0x25
BIT_RATES = {9_600: 0x42, 19_200: 0x41, 38_400: 0x40, 500_000: 0x48}

# Of the status byte.
DIRTY = 0x80
SEVERITY, ERROR = 0x07, 3

POLYNOMIAL = 0x8005
PARTIAL_BIT = 13
PARTIAL_SCANS = 4


class DamagedScan(ValueError):
    """A telegram whose checksum is right, but which is no scan."""


@dataclass(frozen=True)
class Scan:
    """The measured words of a scan.

    Attributes:
        values: (N,) distances, in `unit_m`; the flags are removed.
        unit_m: 0.01 or 0.001.
        partial: number of an interlaced scan, 0 to 3; None: the scan is whole.
        status: the scanner's status byte.
    """

    values: NDArray[np.int64]
    unit_m: float
    partial: int | None
    status: int


def complaint_of(status: int) -> str:
    """Return what a status byte says is wrong with the scanner, in plain words; '' if nothing."""
    if status & DIRTY:
        return "the scanner reports that its front screen is dirty: clean it"
    if status & SEVERITY >= ERROR:
        return f"the scanner reports an error (status {status:#04x})"
    return ""


def crc(data: bytes) -> int:
    """Return the checksum of a telegram's bytes: SICK's own rule, not CRC-16/IBM."""
    value = previous = 0
    for byte in data:
        carry = value & 0x8000
        value = (value << 1) & 0xFFFF
        if carry:
            value ^= POLYNOMIAL
        value ^= previous << 8 | byte
        previous = byte
    return value


def telegram(command: int, data: bytes = b"", address: int = 0) -> bytes:
    """Return the bytes of a command to the scanner."""
    body = STX + bytes([address]) + (1 + len(data)).to_bytes(2, "little") + bytes([command]) + data
    return body + crc(body).to_bytes(CRC_BYTES, "little")


class TelegramFraming(Framing[bytes]):
    """The scanner's telegrams. ACK and NAK stand between them, and count as skipped."""

    start = STX
    head_bytes = HEAD_BYTES

    def length(self, head: bytes) -> int | None:
        """Return the length of the telegram, checksum included."""
        if len(head) < HEAD_BYTES:
            return None
        data_bytes = int.from_bytes(head[2:4], "little")
        # Command and status at least.
        if head[1] not in REPLY_ADDRESSES or not 2 <= data_bytes <= MAX_DATA_BYTES:
            raise DamagedFrame("no telegram of the scanner begins like this")
        return HEAD_BYTES + data_bytes + CRC_BYTES

    def parse(self, frame: bytes) -> bytes:
        """Return the whole telegram."""
        if crc(frame[:-CRC_BYTES]) != int.from_bytes(frame[-CRC_BYTES:], "little"):
            raise DamagedFrame("the checksum is wrong")
        return frame


def scan(frame: bytes, range_bits: int = 13) -> Scan:
    """Return the scan in a telegram.

    Args:
        frame: a whole, valid telegram with the command `SCAN`.
        range_bits: bits of a word that are a distance: 13 in the modes up to 8 m or 80 m, 14 up to 16 m or
            160 m, 15 up to 32 m; the others are fields and dazzle flags.

    Raises:
        DamagedScan: the number of values does not fit the length.
    """
    head = int.from_bytes(frame[5:7], "little")
    count = head & 0x3FF
    if len(frame) < HEAD_BYTES + 1 + 2 + 2 * count + 1 + CRC_BYTES:
        raise DamagedScan(f"a scan of {count} values in a telegram of {len(frame)} bytes")
    words = np.frombuffer(frame, "<u2", count, 7).astype(np.int64)
    partial = head >> 11 & (PARTIAL_SCANS - 1) if head >> PARTIAL_BIT & 1 else None
    unit_m = 0.001 if head >> 14 & 3 == 1 else 0.01
    return Scan(words & ((1 << range_bits) - 1), unit_m, partial, frame[-CRC_BYTES - 1])


def least_code(range_bits: int = 13) -> int:
    """Return the least value that is a code rather than a distance: 1FF7 hexadecimal with 13 bits."""
    return (1 << range_bits) - 9
