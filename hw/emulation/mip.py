"""An emulated MicroStrain unit with MIP, such as the 3DM-GX3-25 or GX5-25.

Source: LORD MicroStrain, 3DM-GX5-25 Data Communications Protocol.
"""

import struct
from dataclasses import dataclass

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice
from robbie_robots.hw.emulation.fletcher import fletcher

SYNC = b"\x75\x65"
BASE_COMMANDS, SETTINGS, SENSOR_DATA = 0x01, 0x0C, 0x80
PING, TO_IDLE, RESUME, RESET = 0x01, 0x02, 0x06, 0x7E
ACK = 0xF1
OK, UNKNOWN, WRONG_PARAMETER = 0x00, 0x01, 0x03
BASE_RATE, BASE_RATE_ANSWER, FORMAT, STREAM = 0x06, 0x83, 0x08, 0x11
ACCELERATION, TURN, MAGNETIC, QUATERNION, EULER, GPS_TIME = 0x04, 0x05, 0x06, 0x0A, 0x0C, 0x12
INTERNAL_TIME = 0xD5
EVERYTHING = frozenset({ACCELERATION, TURN, MAGNETIC, QUATERNION, EULER, GPS_TIME, INTERNAL_TIME})


@dataclass
class MipMeasurements:
    """The measurements of the unit; set them to your liking: g, rad/s, gauss, rad.

    The unit's x points ahead, y to the right and z down; the quaternion turns its frame to north, east, down.
    """

    acceleration: tuple[float, ...] = (0.0, 0.0, -1.0)
    turn: tuple[float, ...] = (0.0, 0.0, 0.0)
    magnetic: tuple[float, ...] = (0.2, 0.0, 0.4)
    quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    euler: tuple[float, ...] = (0.0, 0.0, 0.0)


class EmulatedMip(EmulatedDevice):
    """A unit that streams acceleration and turn rate 100 times a second once it has power.

    Args:
        clock: its clock.
        fields: the fields that this model has; it refuses a format with another one.
        base_hz: how often it measures in each second.
    """

    def __init__(
        self,
        clock: EmulatedClock | None = None,
        fields: frozenset[int] = EVERYTHING,
        base_hz: int = 1000,
    ) -> None:
        super().__init__(clock)
        self.bit_rate, self.fields, self.base_hz = 115_200, fields, base_hz
        self.motion = MipMeasurements()
        self.power_on()

    def power_on(self) -> None:
        """Stream with the settings of the factory."""
        self._received = bytearray()
        self.is_streaming = True
        self._fields = [ACCELERATION, TURN]
        self._period_s = 0.01
        self._next_s = self.clock.now_s()

    def receive(self, data: bytes) -> None:
        """Answer packets whose checksum is right."""
        self._received += data
        while (start := self._received.find(SYNC)) >= 0:
            del self._received[:start]
            if len(self._received) < 4 or len(self._received) < 6 + self._received[3]:
                return
            length = 6 + self._received[3]
            whole = bytes(self._received[:length])
            if fletcher(whole[:-2]) != whole[-2:]:
                del self._received[:1]
                continue
            del self._received[:length]
            self._answer(whole[2], whole[4:-2])

    def step(self) -> float | None:
        """Send the measurement that is due."""
        if not self.is_streaming:
            return None
        now_s = self.clock.now_s()
        while self._next_s <= now_s:
            content = [(kind, self._content(kind)) for kind in self._fields]
            self.send(packet(SENSOR_DATA, content), self._next_s)
            self._next_s += self._period_s
        return self._next_s

    def _answer(self, group: int, fields: bytes) -> None:
        answers: list[tuple[int, bytes]] = []
        while len(fields) > 1 and 2 <= fields[0] <= len(fields):
            kind, data, fields = fields[1], fields[2 : fields[0]], fields[fields[0] :]
            code = self._obey(group, kind, data)
            answers.append((ACK, bytes([kind, code])))
            if (group, kind, code) == (SETTINGS, BASE_RATE, OK):
                answers.append((BASE_RATE_ANSWER, self.base_hz.to_bytes(2, "big")))
        self.send(packet(group, answers))

    def _obey(self, group: int, kind: int, data: bytes) -> int:
        """Follow a command; return the code of its acknowledgement."""
        if group == BASE_COMMANDS and kind in (PING, TO_IDLE, RESUME, RESET):
            if kind == TO_IDLE:
                self.is_streaming = False
            elif kind == RESUME:
                self._resume()
            elif kind == RESET:
                self.power_on()
            return OK
        if group == SETTINGS and kind == STREAM and len(data) == 3:
            # New setting, which stream, on or off.
            self.is_streaming = bool(data[2])
            if self.is_streaming:
                self._resume()
            return OK
        if group == SETTINGS and kind == BASE_RATE:
            return OK
        if group == SETTINGS and kind == FORMAT and len(data) > 2:
            described = data[2 : 2 + 3 * data[1]]
            if not self.fields.issuperset(described[::3]):
                return WRONG_PARAMETER
            self._fields = list(described[::3])
            divisors = [
                int.from_bytes(described[at + 1 : at + 3], "big") for at in range(0, len(described), 3)
            ]
            self._period_s = max(min(divisors, default=10), 1) / self.base_hz
            return OK
        return UNKNOWN

    def _resume(self) -> None:
        self.is_streaming, self._next_s = True, self.clock.now_s()

    def _content(self, kind: int) -> bytes:
        motion = self.motion
        values = {ACCELERATION: motion.acceleration, TURN: motion.turn, MAGNETIC: motion.magnetic,
                  EULER: motion.euler}  # fmt: skip
        if kind == INTERNAL_TIME:
            return round(self._next_s * 1e9).to_bytes(8, "big")
        if kind == QUATERNION:
            return struct.pack(">4f", *motion.quaternion)
        if kind == GPS_TIME:
            return struct.pack(">dHH", self._next_s % 604_800, 2000, 7)
        return struct.pack(">3f", *values.get(kind, (0.0, 0.0, 0.0)))


def packet(group: int, fields: list[tuple[int, bytes]]) -> bytes:
    """Return a packet of fields with its checksum."""
    payload = b"".join(bytes([len(data) + 2, kind]) + data for kind, data in fields)
    body = SYNC + bytes([group, len(payload)]) + payload
    return body + fletcher(body)
