"""An emulated SICK TiM or LMS1xx.

Source: SICK AG, Telegram Listing of the ranging sensors LMS1xx, LMS5xx and TiM; SICK AG, operating
instructions of the TiM51x (what the time since start-up names there).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice

STX, ETX = b"\x02", b"\x03"
BINARY_START = 4 * STX
MAX_TELEGRAM_BYTES = 1000
NUMBER = 18480390
BRIGHTNESS = 150
MAX_MM = 65_535

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScannerModel:
    """A scanner.

    Attributes:
        name: the model.
        start_deg: direction of the first beam; 0: to the right, 90: ahead.
        step_1e4_deg: angle between beams, 0.0001 degrees.
        beams: number of beams.
        rate_hz: scans in a second.
        tells_end: the time since start-up names the end of the scan; else its beginning.
        work_s: time from the end of a scan until its telegram is sent.
    """

    name: str
    start_deg: float
    step_1e4_deg: int
    beams: int
    rate_hz: float
    tells_end: bool
    work_s: float

    def angles_rad(self) -> Array:
        """Return the direction of each beam, counter-clockwise, 0 ahead: (beams,)."""
        return np.radians(self.start_deg - 90 + np.arange(self.beams) * self.step_1e4_deg / 1e4)

    @property
    def field_s(self) -> float:
        """Return the time from the first to the last beam."""
        return (self.beams - 1) * self.step_1e4_deg / 1e4 / 360 / self.rate_hz


TIM_561 = ScannerModel("TiM561", -45.0, 3333, 811, 15.0, True, 0.004)
LMS_111 = ScannerModel("LMS111", -45.0, 5000, 541, 50.0, False, 0.002)


class EmulatedSickScanner(EmulatedDevice):
    """A scanner on TCP that measures from power-on and sends its scans while a host wants them.

    Args:
        measure: gets the number of a scan, at its beginning; returns the ranges in the directions of
            `model.angles_rad()`, m; not finite: none.
        model: which scanner.
        is_text: it speaks CoLa A, as text; else CoLa B, binary.
        clock: its clock.

    Attributes:
        status: the device status in its scans.
    """

    def __init__(
        self,
        measure: Callable[[int], Array],
        model: ScannerModel = TIM_561,
        is_text: bool = False,
        clock: EmulatedClock | None = None,
    ) -> None:
        super().__init__(clock)
        self.model, self._measure, self._is_text = model, measure, is_text
        self.status = 0
        self.power_on()

    def power_on(self) -> None:
        """Measure ranges without intensities, and send nothing."""
        self._received = b""
        self._is_streaming = self._has_intensities = self._is_logged_in = False
        self._scan = 0
        self._telegrams = 0
        self._began_s = self.clock.now_s()
        self._ranges: Array | None = None

    def receive(self, data: bytes) -> None:
        """Take telegrams; answer those that it knows, refuse others."""
        self._received = (self._received + data)[-MAX_TELEGRAM_BYTES:]
        while (payload := self._next_text() if self._is_text else self._next_binary()) is not None:
            self._obey(payload)

    def step(self) -> float | None:
        """Measure, and send the scan when it is whole."""
        now_s, model = self.clock.now_s(), self.model
        while True:
            if self._ranges is None:
                if now_s < self._began_s:
                    return self._began_s
                self._ranges = self._measure(self._scan)
            sent_s = self._began_s + model.field_s + model.work_s
            if now_s < sent_s:
                return sent_s
            if self._is_streaming:
                self._telegrams += 1
                self._send(self._scan_data(self._ranges, sent_s))
            self._ranges = None
            self._scan += 1
            self._began_s += 1 / model.rate_hz

    def _next_text(self) -> bytes | None:
        text, end, rest = self._received.partition(ETX)
        if not end:
            return None
        self._received = rest
        return text.rpartition(STX)[2]

    def _next_binary(self) -> bytes | None:
        while (begin := self._received.find(BINARY_START)) >= 0:
            self._received = self._received[begin:]
            length = int.from_bytes(self._received[4:8], "big")
            if len(self._received) >= 8 and length > MAX_TELEGRAM_BYTES:
                self._received = self._received[1:]
                continue
            if len(self._received) < 9 + length:
                return None
            payload, told = self._received[8 : 8 + length], self._received[8 + length]
            self._received = self._received[9 + length :]
            if reduce(xor, payload, 0) == told:
                return payload
        return None

    def _obey(self, payload: bytes) -> None:
        verb, _, rest = payload.partition(b" ")
        name, _, values = rest.partition(b" ")
        match verb, name:
            case b"sMN", b"SetAccessMode":
                password = b"03 F4724744" if self._is_text else b"\x03\xf4\x72\x47\x44"
                self._is_logged_in = values == password
                self._answer(b"sAN SetAccessMode", self._is_logged_in)
            case b"sWN", b"LMDscandatacfg" if self._is_logged_in:
                # The second field after the channel: whether intensities are sent.
                self._has_intensities = values.split()[2] == b"1" if self._is_text else values[2] == 1
                self._answer(b"sWA LMDscandatacfg", None)
            case b"sMN", b"LMCstartmeas":
                self._answer(b"sAN LMCstartmeas", False)
            case b"sMN", b"Run":
                self._is_logged_in = False
                self._answer(b"sAN Run", True)
            case b"sEN", b"LMDscandata":
                self._is_streaming = values in (b"1", b"\x01")
                self._answer(b"sEA LMDscandata", self._is_streaming)
            case _:
                # Not known, or not allowed.
                self._send(b"sFA " + (b"3" if self._is_text else b"\x00\x03"))

    def _answer(self, name: bytes, value: bool | None) -> None:
        if value is None:
            self._send(name)
        else:
            self._send(name + b" " + (b"%d" % value if self._is_text else bytes([value])))

    def _send(self, payload: bytes) -> None:
        if self._is_text:
            self.send(STX + payload + ETX)
        else:
            length = len(payload).to_bytes(4, "big")
            self.send(BINARY_START + length + payload + bytes([reduce(xor, payload, 0)]))

    def _scan_data(self, ranges_m: Array, sent_s: float) -> bytes:
        """Return the payload of a scan's telegram: fields and their sizes first, then in the dialect."""
        model = self.model
        told_s = self._began_s + (model.field_s if model.tells_end else 0.0)
        fields: list[tuple[int, int] | bytes] = [
            (1, 2), (1, 2), (NUMBER, 4), (0, 1), (self.status, 1), (self._telegrams % 0x10000, 2),
            (self._scan % 0x10000, 2), (_microseconds(told_s), 4), (_microseconds(sent_s), 4), (0, 1), (0, 1),
            (8, 1), (0, 1), (0, 2), (round(model.rate_hz * 100), 4), (162, 4), (0, 2),
        ]  # fmt: skip
        millimetres = ranges_m * 1000
        seen = np.isfinite(millimetres) & (millimetres <= MAX_MM)
        values = np.where(seen, np.round(np.where(seen, millimetres, 0)), 0).astype(np.int64)
        channels = {b"DIST1": values}
        if self._has_intensities:
            channels[b"RSSI1"] = np.where(seen, BRIGHTNESS, 0)
        fields.append((len(channels), 2))
        for name, numbers in channels.items():
            start = round(model.start_deg * 1e4) & 0xFFFFFFFF
            fields += [name, (0x3F800000, 4), (0, 4), (start, 4), (model.step_1e4_deg, 2), (len(numbers), 2)]
            fields += [(int(number), 2) for number in numbers]
        # No 8-bit channels, position, name, comment, time and event.
        fields += [(0, 2)] * 6
        if self._is_text:
            words = [field if isinstance(field, bytes) else b"%X" % field[0] for field in fields]
            return b"sSN LMDscandata " + b" ".join(words)
        packed = [f if isinstance(f, bytes) else f[0].to_bytes(f[1], "big") for f in fields]
        return b"sSN LMDscandata " + b"".join(packed)


def _microseconds(shown_s: float) -> int:
    return int(shown_s * 1e6) % (1 << 32)
