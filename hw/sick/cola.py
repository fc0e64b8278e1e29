"""CoLa A and B, the protocols of SICK's TiM, LMS1xx and LMS5xx lasers.

Source: SICK AG, Telegram Listing of the ranging sensors LMS1xx, LMS5xx and TiM. A is text without a checksum,
its numbers are hexadecimal; B is binary.
"""

import struct
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import reduce
from operator import xor

import numpy as np
from numpy.typing import NDArray
from strenum import StrEnum

from robbie_robots.hw.framing import DamagedFrame, Framing

# An LMS5xx with 1141 beams, five echoes and intensities.
MAX_FRAME_BYTES = 40_000
MAX_CHANNELS = 16
MAX_ENCODERS = 3
SCAN = b"LMDscandata"
BINARY_MARKER = b"\x02\x02\x02\x02"
BINARY_HEAD_BYTES = 8


class Dialect(StrEnum):
    """How telegrams are written."""

    A = "A"
    """As text."""

    B = "B"
    """Binary."""


class DamagedTelegram(ValueError):
    """A telegram that is not what its beginning says."""


@dataclass(frozen=True)
class ColaCommand:
    """A command in both dialects: the text, and the arguments in binary.

    Attributes:
        name: verb and name, as "sEN LMDscandata".
        text: arguments as text.
        binary: the same arguments in binary.
        answer: what the answer begins with.
    """

    name: str
    text: str
    binary: bytes
    answer: str

    def frame(self, dialect: Dialect) -> bytes:
        """Return the bytes to send."""
        if dialect is Dialect.A:
            return b"\x02" + f"{self.name} {self.text}".strip().encode() + b"\x03"
        payload = self.name.encode() + (b" " + self.binary if self.binary else b"")
        return framed(payload)


LOG_IN = ColaCommand("sMN SetAccessMode", "03 F4724744", bytes.fromhex("03 F4724744"), "sAN SetAccessMode")
CONFIGURE = ColaCommand(
    "sWN LMDscandatacfg",
    "01 00 1 1 0 00 00 0 0 0 0 +1",
    bytes.fromhex("0100 01 01 00 0000 00 00 00 00 0001"),
    "sWA LMDscandatacfg",
)
START_MEASURING = ColaCommand("sMN LMCstartmeas", "", b"", "sAN LMCstartmeas")
RUN = ColaCommand("sMN Run", "", b"", "sAN Run")
STREAM = ColaCommand("sEN LMDscandata", "1", b"\x01", "sEA LMDscandata")
END_STREAM = ColaCommand("sEN LMDscandata", "0", b"\x00", "sEA LMDscandata")


def checksum(payload: bytes) -> int:
    """Return the checksum of a binary payload: all bytes, exclusive or."""
    return reduce(xor, payload, 0)


def framed(payload: bytes) -> bytes:
    """Return the binary telegram with a payload."""
    return BINARY_MARKER + len(payload).to_bytes(4, "big") + payload + bytes([checksum(payload)])


class BinaryFraming(Framing[bytes]):
    """Binary telegrams; what they carry is their payload."""

    start = BINARY_MARKER
    head_bytes = BINARY_HEAD_BYTES

    def length(self, head: bytes) -> int | None:
        """Return the length of the telegram, checksum included."""
        if len(head) < BINARY_HEAD_BYTES:
            return None
        length = int.from_bytes(head[4:], "big")
        if not 0 < length <= MAX_FRAME_BYTES:
            raise DamagedFrame(f"a telegram of {length} bytes")
        return BINARY_HEAD_BYTES + length + 1

    def parse(self, frame: bytes) -> bytes:
        """Return the payload."""
        payload = frame[BINARY_HEAD_BYTES:-1]
        if int(np.bitwise_xor.reduce(np.frombuffer(payload, np.uint8))) != frame[-1]:
            raise DamagedFrame("the checksum is wrong")
        return payload


class TextReader:
    """Finds telegrams of text between STX and ETX."""

    def __init__(self) -> None:
        self.damaged = 0
        self.skipped_bytes = 0
        self._buffer = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes in pieces of any length; return the texts that are whole now."""
        *parts, self._buffer = (self._buffer + data).split(b"\x03")
        found = []
        for part in parts:
            before, start, text = part.rpartition(b"\x02")
            self.skipped_bytes += len(before) if start else len(part) + 1
            if start:
                found.append(text)
            self.damaged += b"\x02" in before or not start
        if len(self._buffer) > MAX_FRAME_BYTES:
            self.damaged += 1
            self.reset()
        return found

    def reset(self) -> None:
        """Forget half a telegram."""
        self.skipped_bytes += len(self._buffer)
        self._buffer = b""


@dataclass(frozen=True)
class ColaChannel:
    """Values of one kind.

    Attributes:
        name: as "DIST1", "RSSI1".
        scale: of a value.
        offset: to add to a scaled value.
        start_1e4_deg: direction of the first beam, 0.0001 degrees, 90 degrees: ahead.
        step_1e4_deg: angle between beams.
        values: (N,) as sent.
    """

    name: str
    scale: float
    offset: float
    start_1e4_deg: int
    step_1e4_deg: int
    values: NDArray[np.int64]


@dataclass(frozen=True)
class ScanData:
    """The content of the telegram LMDscandata, up to the last channel.

    Attributes:
        serial_number: the device's.
        status: 0 fine, 1 error, 2 pollution warning, 5 pollution error.
        telegram_counter: counts telegrams, 16 bits.
        scan_counter: counts scans, 16 bits.
        start_us: time of the scan since the device was switched on, 32 bits: of its beginning, or on a TiM
            of its end.
        sent_us: time at which the telegram was sent, likewise.
        scan_rate_hz: scans in a second.
        channels: the 16-bit channels, then the 8-bit channels.
    """

    serial_number: int
    status: int
    telegram_counter: int
    scan_counter: int
    start_us: int
    sent_us: int
    scan_rate_hz: float
    channels: list[ColaChannel]


class _Fields(ABC):
    """Reads the fields of a telegram one after the other."""

    @abstractmethod
    def unsigned(self, size: int) -> int:
        """Return the next number of `size` bytes."""

    @abstractmethod
    def name(self) -> str:
        """Return the next name of a channel."""

    @abstractmethod
    def array(self, count: int, size: int) -> NDArray[np.int64]:
        """Return the next numbers of `size` bytes each."""

    def signed(self, size: int) -> int:
        """Return the next number, which may be negative."""
        value = self.unsigned(size)
        return value - (1 << 8 * size) if value >> (8 * size - 1) & 1 else value

    def real(self) -> float:
        """Return the next number with a fraction."""
        value: float = struct.unpack(">f", self.unsigned(4).to_bytes(4, "big"))[0]
        return value


class _TextFields(_Fields):
    def __init__(self, payload: bytes) -> None:
        self._words = payload.split()[2:]
        self._at = 0

    def _next(self) -> bytes:
        self._at += 1
        return self._words[self._at - 1]

    def unsigned(self, size: int) -> int:
        value = _number(self._next())
        if value >> 8 * size:
            raise ValueError(f"{value} does not fit {size} bytes")
        return value

    def signed(self, size: int) -> int:
        if self._words[self._at][:1] in b"+-":
            return _number(self._next())
        return super().signed(size)

    def name(self) -> str:
        return self._next().decode("ascii")

    def array(self, count: int, size: int) -> NDArray[np.int64]:
        words = self._words[self._at : self._at + count]
        self._at += count
        values = np.array([int(word, 16) for word in words], np.int64)
        if len(values) != count or (count and not 0 <= values.min() <= values.max() < 1 << 8 * size):
            raise ValueError(f"{count} values expected")
        return values


class _BinaryFields(_Fields):
    NAME_BYTES = 5

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        # Verb and name end in a blank each.
        self._at = payload.index(b" ", payload.index(b" ") + 1) + 1

    def _next(self, size: int) -> bytes:
        self._at += size
        if self._at > len(self._payload):
            raise ValueError("the telegram ends too early")
        return self._payload[self._at - size : self._at]

    def unsigned(self, size: int) -> int:
        return int.from_bytes(self._next(size), "big")

    def name(self) -> str:
        return self._next(self.NAME_BYTES).decode("ascii")

    def array(self, count: int, size: int) -> NDArray[np.int64]:
        return np.frombuffer(self._next(count * size), f">u{size}").astype(np.int64)


def scan_data(payload: bytes, dialect: Dialect) -> ScanData:
    """Return what a telegram LMDscandata says.

    Raises:
        DamagedTelegram: it is not such a telegram, or not whole.
    """
    try:
        fields = _TextFields(payload) if dialect is Dialect.A else _BinaryFields(payload)
        return _scan_data(fields)
    except (IndexError, ValueError, OverflowError) as error:
        raise DamagedTelegram(f"not a whole LMDscandata: {error}") from error


def _scan_data(fields: _Fields) -> ScanData:
    fields.unsigned(2), fields.unsigned(2)  # version and number of the device
    serial_number = fields.unsigned(4)
    _, status = fields.unsigned(1), fields.unsigned(1)
    telegram_counter, scan_counter = fields.unsigned(2), fields.unsigned(2)
    start_us, sent_us = fields.unsigned(4), fields.unsigned(4)
    for _ in range(4):
        fields.unsigned(1)  # digital inputs and outputs
    fields.unsigned(2)
    scan_rate_hz = fields.unsigned(4) / 100
    fields.unsigned(4)  # rate of single measurements
    for _ in range(_count(fields, MAX_ENCODERS)):
        fields.unsigned(4), fields.unsigned(2)
    channels = [_channel(fields, size) for size in (2, 1) for _ in range(_count(fields, MAX_CHANNELS))]
    return ScanData(
        serial_number, status, telegram_counter, scan_counter, start_us, sent_us, scan_rate_hz, channels
    )


def _channel(fields: _Fields, size: int) -> ColaChannel:
    name, scale, offset = fields.name(), fields.real(), fields.real()
    start, step, count = fields.signed(4), fields.unsigned(2), fields.unsigned(2)
    return ColaChannel(name, scale, offset, start, step, fields.array(count, size))


def _count(fields: _Fields, limit: int) -> int:
    count = fields.unsigned(2)
    if count > limit:
        raise ValueError(f"{count} channels or encoders")
    return count


def _number(word: bytes) -> int:
    """Return a number: decimal if it has a sign, else hexadecimal."""
    return int(word) if word[:1] in (b"+", b"-") else int(word, 16)
