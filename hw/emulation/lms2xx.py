"""An emulated SICK LMS200, 211, 220, 221 or 291.

Source: SICK AG, Telegrams for Configuring and Operating the LMS2xx Laser Measurement Systems.
"""

import struct
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice

STX, ACK, NAK = 0x02, b"\x06", b"\x15"
ADDRESS_OF_REPLIES = 0x80
STATUS = 0x10
RATES = {0x42: 9_600, 0x41: 19_200, 0x40: 38_400, 0x48: 500_000}
# The scanner has answered at the old rate before it takes the new one.
RATE_CHANGE_S = 0.005
TURN_S = 1.0 / 75.0
# Turns of the mirror for a scan, by the hundredths of a degree between its values.
TURNS = {100: 1, 50: 2, 25: 4}
NO_RETURN = 0x1FFF
MAX_CM = 0x1FF6
MAX_COMMAND_BYTES = 32
BITS_PER_BYTE = 10

Array = NDArray[np.float64]


class EmulatedLms2xx(EmulatedDevice):
    """A scanner that measures with every turn of its mirror and sends scans while a host wants them.

    A scan begins with its first value. When its last value is measured, its telegram goes out, if the line
    has sent the one before; else nobody hears of that scan. With 0.25 degrees a scan comes in four parts,
    each of one turn.

    Args:
        measure: gets the number of the scan and the directions, rad, counter-clockwise, 0 ahead; returns
            the ranges, m; not finite: none.
        clock: its clock.

    Attributes:
        variant: field of view, degrees, and hundredths of a degree between values.
        status: the status byte in its replies.
        scans_began_s: when the newest scan began, on its clock.
    """

    def __init__(self, measure: Callable[[int, Array], Array], clock: EmulatedClock | None = None) -> None:
        super().__init__(clock)
        self._measure = measure
        self.status = STATUS
        self.power_on()

    def power_on(self) -> None:
        """Start at 9,600 bit/s, with 180 degrees by 0.5, and send nothing."""
        self.bit_rate = RATES[0x42]
        self.variant = (180, 50)
        self._rate_to_come: tuple[float, int] | None = None
        self._received = bytearray()
        self._is_streaming = False
        self._line_free_s = 0.0
        self._restart_scans()

    def receive(self, data: bytes) -> None:
        """Take telegrams; a damaged one is answered with NAK."""
        self._received += data
        while (begin := self._received.find(STX)) >= 0:
            del self._received[:begin]
            if len(self._received) < 4:
                return
            length = int.from_bytes(self._received[2:4], "little")
            if self._received[1] != 0 or not 1 <= length <= MAX_COMMAND_BYTES:
                del self._received[0]
                continue
            if len(self._received) < length + 6:
                return
            body, told = bytes(self._received[: length + 4]), self._received[length + 4 : length + 6]
            if checksum(body) != int.from_bytes(told, "little"):
                self.send(NAK)
                del self._received[0]
                continue
            del self._received[: length + 6]
            self._obey(body[4], body[5:])
        self._received.clear()

    def step(self) -> float | None:
        """Change the rate if it is time to, and send the scans that are whole."""
        now_s = self.clock.now_s()
        if self._rate_to_come is not None and self._rate_to_come[0] <= now_s:
            self.bit_rate, self._rate_to_come = self._rate_to_come[1], None
        while self._is_streaming and self._part_ends_s() <= now_s:
            self._end_part()
        due = [self._rate_to_come[0]] if self._rate_to_come is not None else []
        due += [self._part_ends_s()] if self._is_streaming else []
        return min(due, default=None)

    def _obey(self, command: int, data: bytes) -> None:
        self.send(ACK)
        match command:
            case 0x20 if data:
                self._change_mode(data[0])
            case 0x30 if data == b"\x01":
                self._reply(0xB0, self._values(0, self._angles()))
            case 0x31:
                self._reply(0xB1, b"X25.27 " + bytes(145))
            case 0x3A:
                self._reply(0xBA, b"LMS200;30106;V02.30")
            case 0x3B if len(data) == 4:
                field_deg, step = struct.unpack("<HH", data)
                is_known = step in TURNS and field_deg in ((100,) if step == 25 else (100, 180))
                if is_known:
                    self.variant = (field_deg, step)
                    self._restart_scans()
                self._reply(0xBB, bytes([is_known]) + struct.pack("<HH", *self.variant))
            case _:
                self._reply(0x92, b"")

    def _change_mode(self, mode: int) -> None:
        if mode in RATES:
            self._rate_to_come = (self.clock.now_s() + RATE_CHANGE_S, RATES[mode])
        elif mode in (0x24, 0x25):
            self._is_streaming = mode == 0x24
            self._restart_scans()
        self._reply(0xA0, b"\x00" if mode in (*RATES, 0x24, 0x25) else b"\x01")

    def _restart_scans(self) -> None:
        self._number = self._part = 0
        self.scans_began_s = self.clock.now_s()

    def _part_ends_s(self) -> float:
        """Return when the last value of the current scan, or of its current part, is measured."""
        field_deg, step = self.variant
        turns = self._part if step == 25 else TURNS[step] - 1
        return self.scans_began_s + (turns + field_deg / 360) * TURN_S

    def _end_part(self) -> None:
        """Send the scan, or its part, if the line is free; begin the next one."""
        ended_s, step = self._part_ends_s(), self.variant[1]
        angles = self._angles()[self._part :: 4] if step == 25 else self._angles()
        if self._line_free_s <= ended_s:
            head = 0x2000 | self._part << 11 if step == 25 else 0
            telegram = self._reply(0xB0, self._values(self._number, angles, head), ended_s)
            self._line_free_s = ended_s + len(telegram) * BITS_PER_BYTE / (self.bit_rate or 1)
        if step == 25 and self._part < 3:
            self._part += 1
            return
        self._part = 0
        self._number += 1
        self.scans_began_s += TURNS[step] * TURN_S

    def _angles(self) -> Array:
        field_deg, step = self.variant
        return np.radians(np.arange(-field_deg * 50, field_deg * 50 + 1, step) / 100)

    def _values(self, number: int, angles: Array, head: int = 0) -> bytes:
        centimetres = self._measure(number, angles) * 100
        seen = np.isfinite(centimetres) & (centimetres <= MAX_CM)
        words = np.where(seen, np.round(np.where(seen, centimetres, 0)), NO_RETURN).astype("<u2")
        return struct.pack("<H", len(words) | head) + words.tobytes()

    def _reply(self, kind: int, data: bytes, at_s: float | None = None) -> bytes:
        inside = bytes([kind]) + data + bytes([self.status])
        body = struct.pack("<BBH", STX, ADDRESS_OF_REPLIES, len(inside)) + inside
        telegram = body + checksum(body).to_bytes(2, "little")
        self.send(telegram, at_s)
        return telegram


def checksum(data: bytes) -> int:
    """Return the checksum of a telegram: the polynomial 8005 hexadecimal over pairs of bytes."""
    total, last = 0, 0
    for byte in data:
        total = (total << 1 ^ (0x8005 if total & 0x8000 else 0)) & 0xFFFF
        total ^= last << 8 | byte
        last = byte
    return total
