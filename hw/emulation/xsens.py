"""An emulated Xsens MTi with MTData2.

Source: Xsens Technologies, MT Low-Level Communication Protocol Documentation.
"""

import struct
from dataclasses import dataclass

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice

PREAMBLE = b"\xfa\xff"
MAX_SHORT_BYTES = 254
FINE_TIME_HZ = 10_000

WAKE_UP, WAKE_UP_ACK = 0x3E, 0x3F
REQUEST_DEVICE_ID, GO_TO_MEASUREMENT, GO_TO_CONFIG, MTDATA2 = 0x00, 0x10, 0x30, 0x36
RESET, ERROR, SET_OUTPUT = 0x40, 0x42, 0xC0
INVALID_MESSAGE = 4

PACKET_COUNTER, FINE_TIME, QUATERNION, EULER = 0x1020, 0x1060, 0x2010, 0x2030
ACCELERATION, RATE_OF_TURN, MAGNETIC_FIELD, STATUS = 0x4020, 0x8020, 0xC020, 0xE020
DOUBLE = 3


@dataclass
class XsensMeasurements:
    """The measurements of the unit; set them to your liking.

    Attributes:
        quaternion: w, x, y, z.
        euler_deg: roll, pitch, yaw.
        acceleration: m/s2.
        turn: rad/s.
        magnetic: in units of the field where it was calibrated.
        status: bits: 0 self-test passed, 1 filter valid.
    """

    quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    euler_deg: tuple[float, ...] = (0.0, 0.0, 0.0)
    acceleration: tuple[float, ...] = (0.0, 0.0, 9.81)
    turn: tuple[float, ...] = (0.0, 0.0, 0.0)
    magnetic: tuple[float, ...] = (0.4, 0.0, -0.9)
    status: int = 3


class EmulatedMti(EmulatedDevice):
    """A unit that measures as soon as it has power, unless a host says otherwise.

    Attributes:
        motion: what it measures.
        is_measuring: it sends; False: it is configured.
    """

    def __init__(self, clock: EmulatedClock | None = None) -> None:
        super().__init__(clock)
        self.bit_rate = 115_200
        self.motion = XsensMeasurements()
        self.device_id = 0x01234567
        # Kept without power.
        self._outputs = [(PACKET_COUNTER, 0xFFFF), (FINE_TIME, 0xFFFF), (QUATERNION, 100),
                         (ACCELERATION, 100), (RATE_OF_TURN, 100), (STATUS, 0xFFFF)]  # fmt: skip
        self.power_on()

    def power_on(self) -> None:
        """Say so, and measure."""
        self._received = bytearray()
        self.is_measuring = True
        self._counter = 0
        self._next_s = self.clock.now_s()
        self.send(message(WAKE_UP))

    def receive(self, data: bytes) -> None:
        """Answer messages whose checksum is right."""
        self._received += data
        while (start := self._received.find(PREAMBLE)) >= 0:
            del self._received[:start]
            if len(self._received) < 5:
                return
            length, head = self._received[3], 4
            if length == 0xFF:
                if len(self._received) < 7:
                    return
                length, head = int.from_bytes(self._received[4:6], "big"), 6
            if length > 2048:
                del self._received[:1]
                continue
            if len(self._received) < head + length + 1:
                return
            whole = bytes(self._received[: head + length + 1])
            if sum(whole[1:]) & 0xFF:
                del self._received[:1]
                continue
            del self._received[: len(whole)]
            self._obey(whole[2], whole[head:-1])

    def step(self) -> float | None:
        """Send the measurement that is due."""
        if not self.is_measuring:
            return None
        now_s = self.clock.now_s()
        rates = [rate for _, rate in self._outputs if 0 < rate < 0xFFFF]
        period_s = 1.0 / max(rates, default=100)
        while self._next_s <= now_s:
            self.send(message(MTDATA2, self._data(self._next_s)), self._next_s)
            self._counter = self._counter + 1 & 0xFFFF
            self._next_s += period_s
        return self._next_s

    def _obey(self, kind: int, data: bytes) -> None:
        if kind == WAKE_UP_ACK:
            self.is_measuring = False
        elif kind == GO_TO_CONFIG:
            self.is_measuring = False
            self._acknowledge(kind)
        elif kind == RESET:
            self._acknowledge(kind)
            self.power_on()
        elif self.is_measuring:
            return  # it hears other messages only while it is configured
        elif kind == GO_TO_MEASUREMENT:
            self._acknowledge(kind)
            self.is_measuring, self._next_s = True, self.clock.now_s()
        elif kind == REQUEST_DEVICE_ID:
            self._acknowledge(kind, self.device_id.to_bytes(4, "big"))
        elif kind == SET_OUTPUT and len(data) % 4 == 0:
            if data:
                self._outputs = [struct.unpack(">HH", data[at : at + 4]) for at in range(0, len(data), 4)]
            self._acknowledge(kind, b"".join(struct.pack(">HH", *output) for output in self._outputs))
        else:
            self.send(message(ERROR, bytes([INVALID_MESSAGE])))

    def _acknowledge(self, kind: int, data: bytes = b"") -> None:
        self.send(message(kind + 1, data))

    def _data(self, now_s: float) -> bytes:
        blocks = b""
        for kind, _ in self._outputs:
            content = self._content(kind, now_s)
            if content:
                blocks += kind.to_bytes(2, "big") + bytes([len(content)]) + content
        return blocks

    def _content(self, kind: int, now_s: float) -> bytes:
        base, code = kind & 0xFFF0, "d" if kind & 3 == DOUBLE else "f"
        motion = self.motion
        values = {
            QUATERNION: motion.quaternion,
            EULER: motion.euler_deg,
            ACCELERATION: motion.acceleration,
            RATE_OF_TURN: motion.turn,
            MAGNETIC_FIELD: motion.magnetic,
        }
        if base in values:
            return struct.pack(f">{len(values[base])}{code}", *values[base])
        whole = {
            PACKET_COUNTER: (self._counter, 2),
            FINE_TIME: (int(now_s * FINE_TIME_HZ) & 0xFFFFFFFF, 4),
            STATUS: (motion.status, 4),
        }
        value, size = whole.get(base, (0, 0))
        return value.to_bytes(size, "big")


def message(kind: int, data: bytes = b"") -> bytes:
    """Return a message with preamble, length and checksum."""
    if len(data) > MAX_SHORT_BYTES:
        body = b"\xff" + bytes([kind, 0xFF]) + len(data).to_bytes(2, "big") + data
    else:
        body = b"\xff" + bytes([kind, len(data)]) + data
    return PREAMBLE[:1] + body + bytes([-sum(body) & 0xFF])
