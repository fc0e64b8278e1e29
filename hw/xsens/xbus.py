"""The Xbus protocol of Xsens' MTi units: `MTData2` of newer units, and `MTData` of older ones.

Source: Xsens Technologies, MT Low-Level Communication Protocol Documentation (MT0101P, and MT0100P for
`MTData`).
"""

import math
import struct
from collections.abc import Sequence
from enum import IntEnum, IntFlag
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

# Longer messages exist only in firmware updates.
MAX_DATA_BYTES = 2_048
_EXTENDED = 0xFF


class MessageId(IntEnum):
    """The messages that this driver uses."""

    REQUEST_DEVICE_ID = 0x00
    GO_TO_MEASUREMENT = 0x10
    GO_TO_CONFIG = 0x30
    DATA = 0x32
    DATA2 = 0x36
    WAKE_UP = 0x3E
    WAKE_UP_ANSWER = 0x3F
    RESET = 0x40
    ERROR = 0x42
    SET_OUTPUT_CONFIGURATION = 0xC0
    SET_OUTPUT_MODE = 0xD0
    SET_OUTPUT_SETTINGS = 0xD2


class XbusMessage(NamedTuple):
    """A message: its number, and its data."""

    number: int
    data: bytes


def message(number: int, data: bytes = b"") -> bytes:
    """Return a message's bytes.

    Raises:
        ValueError: the data is too long.
    """
    if len(data) > MAX_DATA_BYTES:
        raise ValueError(f"a message has at most {MAX_DATA_BYTES} bytes of data, not {len(data)}")
    extended = len(data) >= _EXTENDED
    length = struct.pack(">BH", _EXTENDED, len(data)) if extended else bytes([len(data)])
    body = bytes([0xFF, number]) + length + data
    return b"\xfa" + body + bytes([-sum(body) & 0xFF])


def output_configuration(outputs: Sequence[tuple[int, int]]) -> bytes:
    """Return the message that chooses a newer unit's outputs: pairs of a data identifier and a rate in Hz."""
    return message(
        MessageId.SET_OUTPUT_CONFIGURATION, b"".join(struct.pack(">HH", *output) for output in outputs)
    )


class XbusFraming(Framing[XbusMessage]):
    """The messages of a unit that stands alone (bus identifier FF)."""

    start = b"\xfa\xff"
    head_bytes = 6

    def length(self, head: bytes) -> int | None:
        """Return the length, which is one byte or, if that is FF, the next two."""
        if len(head) < 4:
            return None
        if head[3] < _EXTENDED:
            return 5 + head[3]
        if len(head) < 6:
            return None
        data_bytes = head[4] << 8 | head[5]
        if not _EXTENDED <= data_bytes <= MAX_DATA_BYTES:
            raise DamagedFrame(f"a long message of {data_bytes} bytes")
        return 7 + data_bytes

    def parse(self, frame: bytes) -> XbusMessage:
        """Return the message."""
        if sum(frame[1:]) & 0xFF:
            raise DamagedFrame("wrong checksum")
        return XbusMessage(frame[2], frame[6 if frame[3] == _EXTENDED else 4 : -1])


class XbusData(NamedTuple):
    """The content of a data message; None: the message does not hold this.

    Attributes:
        packet_counter: counts the messages, modulo 65536.
        sample_time_s: the unit's clock; it wraps after 2^32 of its ticks.
        quaternion: w, x, y, z.
        euler_deg: roll, pitch, yaw.
        acceleration_m_per_s2: along x, y, z.
        turn_rad_per_s: about x, y, z.
        magnetic_field: along x, y, z, in units of the Earth's field.
        temperature_c: of the unit.
        status: the unit's status bits.
    """

    packet_counter: int | None = None
    sample_time_s: float | None = None
    quaternion: tuple[float, ...] | None = None
    euler_deg: tuple[float, ...] | None = None
    acceleration_m_per_s2: tuple[float, ...] | None = None
    turn_rad_per_s: tuple[float, ...] | None = None
    magnetic_field: tuple[float, ...] | None = None
    temperature_c: float | None = None
    status: int | None = None


# Data identifiers without their low nibble, which tells the precision and the frame: name, number of values.
_REALS = {
    0x0810: ("temperature_c", 1),
    0x2010: ("quaternion", 4),
    0x2030: ("euler_deg", 3),
    0x4020: ("acceleration_m_per_s2", 3),
    0x8020: ("turn_rad_per_s", 3),
    0xC020: ("magnetic_field", 3),
}
# Names, formats, and divisors of what is no real number.
_WHOLE = {
    0x1020: ("packet_counter", ">H", None),
    0x1060: ("sample_time_s", ">I", 10_000),
    0xE010: ("status", ">B", None),
    0xE020: ("status", ">I", None),
}


def data2(sent: XbusMessage) -> XbusData:
    """Return what an `MTData2` message tells; unknown data and numbers that are not finite are left out.

    Raises:
        DamagedFrame: it is another message, or its parts do not fit.
    """
    if sent.number != MessageId.DATA2:
        raise DamagedFrame(f"message {sent.number:02X} instead of MTData2")
    values: dict[str, object] = {}
    position = 0
    while position < len(sent.data):
        if position + 3 > len(sent.data):
            raise DamagedFrame("the last part is cut")
        identifier, length = struct.unpack_from(">HB", sent.data, position)
        part = sent.data[position + 3 : position + 3 + length]
        if len(part) < length:
            raise DamagedFrame(f"part {identifier:04X} is cut")
        values.update(_part(identifier, part))
        position += 3 + length
    return XbusData(**values)  # type: ignore[arg-type]  # each name has the type of its attribute


def _part(identifier: int, part: bytes) -> dict[str, object]:
    kind, precision = identifier & 0xFFF0, identifier & 0x3
    if kind in _WHOLE:
        name, layout, divisor = _WHOLE[kind]
        _check_length(identifier, part, struct.calcsize(layout))
        (value,) = struct.unpack(layout, part)
        return {name: value if divisor is None else value / divisor}
    if kind not in _REALS:
        return {}
    name, count = _REALS[kind]
    numbers = _real_numbers(identifier, part, count, precision)
    if not math.isfinite(sum(numbers)):
        return {}
    return {name: numbers if count > 1 else numbers[0]}


def _real_numbers(identifier: int, part: bytes, count: int, precision: int) -> tuple[float, ...]:
    """Return numbers as float, fixed point 12.20, fixed point 16.32, or double."""
    _check_length(identifier, part, count * (4, 4, 6, 8)[precision])
    if precision == 0:
        return struct.unpack(f">{count}f", part)
    if precision == 1:
        return tuple(value / 2**20 for value in struct.unpack(f">{count}i", part))
    if precision == 2:
        # The fraction comes first, then the integer part.
        pairs = struct.iter_unpack(">Ih", part)
        return tuple(whole + fraction / 2**32 for fraction, whole in pairs)
    return struct.unpack(f">{count}d", part)


def _check_length(identifier: int, part: bytes, expected: int) -> None:
    if len(part) != expected:
        raise DamagedFrame(f"part {identifier:04X} has {len(part)} bytes instead of {expected}")


class OutputMode(IntFlag):
    """The choice of data that an older unit sends."""

    TEMPERATURE = 0x0001
    CALIBRATED = 0x0002
    ORIENTATION = 0x0004
    STATUS = 0x0800


class OutputSettings(IntFlag):
    """How an older unit sends it."""

    SAMPLE_COUNTER = 0x0001
    EULER = 0x0004


def output_mode(mode: OutputMode) -> bytes:
    """Return the message that chooses what an older unit sends."""
    return message(MessageId.SET_OUTPUT_MODE, struct.pack(">H", mode))


def output_settings(settings: OutputSettings) -> bytes:
    """Return the message that chooses how an older unit sends it."""
    return message(MessageId.SET_OUTPUT_SETTINGS, struct.pack(">I", settings))


class OldData:
    """Reads `MTData`, whose contents depend on what the unit was told to send.

    Args:
        mode: what the unit sends.
        settings: how.
    """

    def __init__(self, mode: OutputMode, settings: OutputSettings) -> None:
        self._fields: list[tuple[str, int]] = []
        layout = ">"
        orientation = ("euler_deg", 3) if OutputSettings.EULER in settings else ("quaternion", 4)
        calibrated = [("acceleration_m_per_s2", 3), ("turn_rad_per_s", 3), ("magnetic_field", 3)]
        for name, count in (
            *([("temperature_c", 1)] if OutputMode.TEMPERATURE in mode else []),
            *(calibrated if OutputMode.CALIBRATED in mode else []),
            *([orientation] if OutputMode.ORIENTATION in mode else []),
        ):
            self._fields.append((name, count))
            layout += f"{count}f"
        if OutputMode.STATUS in mode:
            self._fields.append(("status", 1))
            layout += "B"
        if OutputSettings.SAMPLE_COUNTER in settings:
            self._fields.append(("packet_counter", 1))
            layout += "H"
        self._layout = struct.Struct(layout)

    def read(self, sent: XbusMessage) -> XbusData:
        """Return what an `MTData` message tells, but for numbers that are not finite.

        Raises:
            DamagedFrame: it is another message, or its length differs from what the unit was told to send.
        """
        if sent.number != MessageId.DATA or len(sent.data) != self._layout.size:
            raise DamagedFrame(
                f"message {sent.number:02X} of {len(sent.data)} bytes, not MTData of {self._layout.size}"
            )
        numbers = list(self._layout.unpack(sent.data))
        values: dict[str, object] = {}
        for name, count in self._fields:
            if math.isfinite(sum(numbers[:count])):
                values[name] = tuple(numbers[:count]) if count > 1 else numbers[0]
            del numbers[:count]
        return XbusData(**values)  # type: ignore[arg-type]  # each name has the type of its attribute
