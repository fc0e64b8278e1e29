"""An emulated Slamtec RPLidar.

Source: Shanghai Slamtec, RPLIDAR Interface Protocol and Application Notes.
"""

import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice

SINGLE, STREAM = 0, 1 << 30
QUALITY = 47
NO_RETURN = 511

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EmulatedMode:
    """A scan mode.

    Attributes:
        name: as the laser tells it.
        answer: kind of its frames: 81 to 85 hexadecimal.
        sample_us: time between samples, microseconds.
    """

    name: str
    answer: int
    sample_us: float


@dataclass(frozen=True)
class RpLidarModel:
    """A laser.

    Attributes:
        number: of the model.
        bit_rate: of its line, bit/s.
        turns_per_s: turns of its mirror.
        ways: its scan modes; the first one is the standard one.
        typical: number of the mode that it recommends.
        tells_ways: it knows GET_LIDAR_CONF; older firmware does not.
    """

    number: int
    bit_rate: int
    turns_per_s: float
    ways: tuple[EmulatedMode, ...]
    typical: int = 0
    tells_ways: bool = True


A1 = RpLidarModel(
    0x18,
    115_200,
    5.5,
    (EmulatedMode("Standard", 0x81, 500), EmulatedMode("Express", 0x82, 250)),
    tells_ways=False,
)
A3 = RpLidarModel(
    0x31,
    256_000,
    10.0,
    (
        EmulatedMode("Standard", 0x81, 250),
        EmulatedMode("Express", 0x82, 125),
        EmulatedMode("Boost", 0x84, 62.5),
        EmulatedMode("Sensitivity", 0x84, 66.5),
        EmulatedMode("HQ", 0x83, 500),
    ),
    typical=3,
)
S2 = RpLidarModel(
    0x71,
    1_000_000,
    10.0,
    (EmulatedMode("Standard", 0x81, 62.5), EmulatedMode("DenseBoost", 0x85, 31.25)),
    typical=1,
)

SAMPLES_OF_FRAME = {0x81: 1, 0x82: 32, 0x83: 16, 0x84: 96, 0x85: 40}
BYTES_OF_FRAME = {0x81: 5, 0x82: 84, 0x83: 141, 0x84: 132, 0x85: 84}


class EmulatedRpLidar(EmulatedDevice):
    """A laser whose mirror turns while it scans; it sends a frame when the frame's last sample is measured.

    Args:
        measure: gets the number of each sample's turn and its direction, rad, clockwise, 0 ahead; returns the
            ranges, m: (N,); not finite: none.
        model: which laser.
        clock: its clock.

    Attributes:
        began_s: when the first sample of turn 0 was measured, on its clock.
        motor_pwm: the speed that the host has ordered.
    """

    def __init__(
        self,
        measure: Callable[[NDArray[np.int64], Array], Array],
        model: RpLidarModel = A1,
        clock: EmulatedClock | None = None,
    ) -> None:
        super().__init__(clock)
        self.model, self.bit_rate, self._measure = model, model.bit_rate, measure
        self.power_on()

    def power_on(self) -> None:
        """Wait for a command."""
        self._received = bytearray()
        self._way: EmulatedMode | None = None
        self.motor_pwm = 0
        self.began_s = 0.0

    def receive(self, data: bytes) -> None:
        """Take requests; what is none, or damaged, is ignored."""
        self._received += data
        while (begin := self._received.find(0xA5)) >= 0:
            del self._received[:begin]
            if len(self._received) < 2:
                return
            command, end = self._received[1], 2
            if command & 0x80:
                if len(self._received) < 3 or len(self._received) < (end := 4 + self._received[2]):
                    return
                if reduce(xor, self._received[:end], 0):
                    del self._received[0]
                    continue
            payload = bytes(self._received[3 : end - 1])
            del self._received[:end]
            self._obey(command, payload)
        self._received.clear()

    def step(self) -> float | None:
        """Send the frames whose last sample is measured."""
        now_s = self.clock.now_s()
        while self._way is not None:
            count, sample_s = SAMPLES_OF_FRAME[self._way.answer], self._way.sample_us * 1e-6
            due_s = self.began_s + ((self._frames + 1) * count - 1) * sample_s
            if due_s > now_s:
                return due_s
            self.send(self._frame(self._way), due_s)
            self._frames += 1
        return None

    def first_sample_s(self, turn: int) -> float:
        """Return when the first sample of a turn is measured, on its clock."""
        assert self._way is not None
        sample_s = self._way.sample_us * 1e-6
        # Not the next one because of a rounding error.
        samples = math.ceil(turn / self.model.turns_per_s / sample_s - 1e-6)
        return self.began_s + samples * sample_s

    def _obey(self, command: int, payload: bytes) -> None:
        model = self.model
        match command:
            case 0x25:
                self._way = None
            case 0x40:
                self.power_on()
                self.send(b"RP LIDAR System.\r\nFirmware Ver 1.29\r\n")
            case 0x50:
                self._answer(0x04, bytes([model.number, 0x1D, 1, 7]) + bytes(range(16)))
            case 0x52:
                self._answer(0x06, bytes(3))
            case 0x59:
                self._answer(0x15, struct.pack("<HH", *(round(way.sample_us) for way in model.ways[:2])))
            case 0x84 if model.tells_ways and len(payload) in (4, 6):
                self._tell(*struct.unpack("<IH", payload.ljust(6, b"\0")))
            case 0x20 | 0x21:
                self._scan(model.ways[0])
            case 0x82 if len(payload) == 5:
                # Older firmware has one other mode, and its number is 0.
                number = payload[0] if model.tells_ways else 1
                if number < len(model.ways):
                    self._scan(model.ways[number])
            case 0xF0:
                self.motor_pwm = int.from_bytes(payload, "little")

    def _tell(self, kind: int, number: int) -> None:
        """Answer GET_LIDAR_CONF: the kind again, and its value."""
        way = self.model.ways[min(number, len(self.model.ways) - 1)]
        values = {
            0x70: struct.pack("<H", len(self.model.ways)),
            0x71: struct.pack("<I", round(way.sample_us * 256)),
            0x74: struct.pack("<I", 25 * 256),
            0x75: bytes([way.answer]),
            0x7C: struct.pack("<H", self.model.typical),
            0x7F: way.name.encode() + b"\0",
        }
        if kind in values:
            self._answer(0x20, struct.pack("<I", kind) + values[kind])

    def _answer(self, kind: int, data: bytes, mode: int = SINGLE, length: int | None = None) -> None:
        size = len(data) if length is None else length
        self.send(b"\xa5\x5a" + struct.pack("<IB", size | mode, kind) + data)

    def _scan(self, way: EmulatedMode) -> None:
        self._way, self._frames = way, 0
        self.began_s = self.clock.now_s()
        self._answer(way.answer, b"", STREAM, BYTES_OF_FRAME[way.answer])

    def _swept_deg(self, first: int, count: int) -> Array:
        """Return how far the mirror has turned since the scan began, for some samples of a frame."""
        assert self._way is not None
        samples = (
            self._frames * SAMPLES_OF_FRAME[self._way.answer] + first + np.arange(count, dtype=np.float64)
        )
        swept: Array = samples * (self._way.sample_us * 1e-6 * self.model.turns_per_s * 360)
        return swept

    def _millimetres(self, swept_deg: Array, behind_deg: Array | float = 0.0) -> Array:
        """Return the ranges in directions that lie behind the mirror, which counts the turns; 0: none."""
        turns = np.floor(swept_deg / 360).astype(np.int64)
        ranges = self._measure(turns, np.radians((swept_deg - behind_deg) % 360)) * 1000
        return np.where(np.isfinite(ranges) & (ranges > 0), ranges, 0.0)

    def _frame(self, way: EmulatedMode) -> bytes:
        count = SAMPLES_OF_FRAME[way.answer]
        swept = self._swept_deg(0, count)
        start = round(swept[0] % 360 * 64) % (360 * 64)
        # The first capsule of a scan says so.
        head = start | (0x8000 if self._frames == 0 else 0)
        match way.answer:
            case 0x81:
                return self._node(swept)
            case 0x82:
                return _checked(head, _cabins(self._millimetres(swept)))
            case 0x83:
                return self._hq(swept)
            case 0x84:
                # How far a beam lies behind depends on what it hits.
                ranges = self._millimetres(swept, 8.0)
                ranges = self._millimetres(swept, behind_deg(ranges))
                ahead = self._swept_deg(count, 1)
                following = self._millimetres(ahead, behind_deg(self._millimetres(ahead, 8.0)))
                return _checked(head, _ultra_cabins(ranges, float(following[0])))
        return _checked(head, np.round(self._millimetres(swept)).clip(0, 65_535).astype("<u2").tobytes())

    def _firsts(self, count: int) -> NDArray[np.bool_]:
        """Return with which samples of a frame a turn begins."""
        firsts: NDArray[np.bool_] = np.diff(np.floor(self._swept_deg(-1, count + 1) / 360)) > 0
        return firsts

    def _node(self, swept: Array) -> bytes:
        is_first, angle = bool(self._firsts(1)[0]), round(swept[0] % 360 * 64)
        distance = min(round(self._millimetres(swept)[0] * 4), 0xFFFF)
        head = QUALITY << 2 | (1 if is_first else 2)
        return struct.pack("<BBBH", head, (angle & 0x7F) << 1 | 1, angle >> 7, distance)

    def _hq(self, swept: Array) -> bytes:
        ranges, firsts = self._millimetres(swept), self._firsts(len(swept))
        body = b"\xa5" + bytes(8)
        for angle, distance, first in zip(swept % 360, ranges, firsts, strict=True):
            told = int(angle * 16_384 / 90), round(distance * 4), QUALITY, int(first)
            body += struct.pack("<HIBB", *told)
        filled = body + bytes(-len(body) % 4)
        return body + struct.pack("<I", zlib.crc32(filled))


def _checked(start: int, data: bytes) -> bytes:
    """Return a capsule: marks A and 5 with the halves of a checksum, the direction, and the data."""
    body = struct.pack("<H", start) + data
    check = reduce(xor, body, 0)
    return bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body


def _cabins(millimetres: Array) -> bytes:
    """Return pairs of distances, 14 bits each; their directions are even, so the offsets are 0."""
    pairs = np.round(millimetres).clip(0, 0x3FFF).astype(int).reshape(-1, 2)
    return b"".join(struct.pack("<HHB", one << 2, two << 2, 0) for one, two in pairs.tolist())


def behind_deg(millimetres: Array) -> Array:
    """Return how far a beam lies behind the mirror: the manual's approximation of the parallax."""
    quarters = np.maximum(millimetres * 4, 1)
    far = np.floor(98_361 / np.maximum(quarters, 200))
    turned = int(8 * math.pi * 65_536 / 180) - far * 64 - np.floor(far**3 / 98_304)
    behind: Array = np.where(quarters >= 200, turned / 65_536 * 180 / math.pi, 7.5)
    return behind


def scaled(millimetres: int) -> tuple[int, int]:
    """Return the 12-bit code of a range and how many low bits it loses."""
    for source, code, bits in ((16_384, 3328, 4), (4096, 1792, 3), (2048, 1280, 2), (512, 512, 1)):
        if millimetres >= source:
            return min(code + (millimetres - source >> bits), 0xFFF), bits
    return millimetres, 0


def unscaled(code: int) -> int:
    """Return the range of a code, mm."""
    for source, begin, bits in ((16_384, 3328, 4), (4096, 1792, 3), (2048, 1280, 2), (512, 512, 1)):
        if code >= begin:
            return source + (code - begin << bits)
    return code


def _ultra_cabins(millimetres: Array, following_mm: float) -> bytes:
    """Return cabins of three ranges: one as a code, two by their difference to it and to the next code."""
    ranges = [round(one) for one in millimetres.tolist()] + [round(following_mm)]
    cabins = b""
    for at in range(0, len(ranges) - 1, 3):
        code, bits = scaled(ranges[at])
        next_code, next_bits = scaled(ranges[at + 3])
        base, next_base = unscaled(code), unscaled(next_code)
        if not base and next_base:
            base, bits = next_base, next_bits
        one = _difference(ranges[at + 1], base, bits)
        two = _difference(ranges[at + 2], next_base, next_bits)
        cabins += struct.pack("<I", code | one << 12 | two << 22)
    return cabins


def _difference(range_mm: int, base_mm: int, bits: int) -> int:
    """Return ten bits: a range's difference to a base, or the mark of no return if it does not fit."""
    value = (range_mm - base_mm) >> bits
    if not range_mm or not -512 < value < NO_RETURN:
        value = NO_RETURN
    return value & 0x3FF
