"""An emulated iRobot Create 2, or Roomba of the 500 to 900 series.

Source: iRobot, Create 2 Open Interface (OI) Specification based on the Roomba 600.
"""

import math

from robbie_robots.hw.emulation.body import ObedientBody, WheeledBody
from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice, oldest_due

BIT_RATES = (300, 600, 1200, 2400, 4800, 9600, 14_400, 19_200, 28_800, 38_400, 57_600, 115_200)
STREAM_HEADER = 19
STREAM_PERIOD_S = 0.015
WHEEL_BASE_M = 0.235
COUNTS_PER_M = 508.8 / (math.pi * 0.072)
MAX_SPEED_MM_PER_S = 500
STRAIGHT = (0x8000, 0x7FFF)

OFF, PASSIVE, SAFE, FULL = range(4)

START, BAUD, CONTROL, SAFE_MODE, FULL_MODE, POWER, RESET, STOP = 128, 129, 130, 131, 132, 133, 7, 173
SPOT, CLEAN, MAX_CLEAN, DOCK = 134, 135, 136, 143
DRIVE, DRIVE_DIRECT, SENSORS, STREAM, QUERY_LIST, PAUSE = 137, 145, 142, 148, 149, 150
DRIVE_PWM, MOTORS, LEDS, SONG, PLAY = 146, 138, 139, 140, 141

MODE_AFTER = {
    START: PASSIVE, CONTROL: SAFE, SAFE_MODE: SAFE, FULL_MODE: FULL, SPOT: PASSIVE, CLEAN: PASSIVE,
    MAX_CLEAN: PASSIVE, DOCK: PASSIVE, POWER: PASSIVE, STOP: OFF,
}  # fmt: skip

# Bytes that follow each command; SONG, STREAM and QUERY_LIST tell theirs.
OPERANDS = {
    BAUD: 1, DRIVE: 4, MOTORS: 1, LEDS: 3, PLAY: 1, SENSORS: 1, 144: 3, DRIVE_DIRECT: 4, DRIVE_PWM: 4,
    PAUSE: 1, 162: 4, 163: 4, 164: 4, 165: 1, 167: 15, 168: 3,
}  # fmt: skip

TWO_BYTES = {19, 20, 22, 23, *range(25, 32), *range(39, 45), *range(46, 52), 54, 55, 56, 57}
SIGNED = {19, 20, 23, 24, 39, 40, 41, 42, 43, 44, 54, 55, 56, 57}
GROUPS = {
    0: (7, 26), 1: (7, 16), 2: (17, 20), 3: (21, 26), 4: (27, 34), 5: (35, 42), 6: (7, 42), 100: (7, 58),
    101: (43, 58), 106: (46, 51), 107: (54, 58),
}  # fmt: skip
UNUSED = {16: 1, 32: 1, 33: 2}


class EmulatedCreate(EmulatedDevice):
    """A Create 2 that turns its wheels as it is told, and has the sensors that you set.

    Attributes:
        sensors: values by the number of their packet, as 22 for the voltage in mV; set them to your liking.
        mode: 0 off, 1 passive, 2 safe, 3 full.
        is_streaming: it sends what a host has asked for, every 15 ms.
        speeds_mm_per_s: of the right and the left wheel.
        songs: notes by the number of the song; `played` lists what was played.
    """

    def __init__(self, clock: EmulatedClock | None = None, body: WheeledBody | None = None) -> None:
        """Create it.

        Args:
            clock: its clock.
            body: moves as its wheels are told; by default exactly so.
        """
        super().__init__(clock)
        self.sensors: dict[int, int] = {}
        self._body = body or ObedientBody()
        self.power_on()

    def power_on(self) -> None:
        """Start in mode off, at 115,200 bit/s."""
        self.bit_rate = BIT_RATES[11]
        self.mode = OFF
        self.speeds_mm_per_s = (0.0, 0.0)
        self.songs: dict[int, bytes] = {}
        self.played: list[int] = []
        self.leds = bytes(3)
        self.sensors |= {21: 0, 22: 15_000, 23: -200, 24: 25, 25: 2500, 26: 2700}
        self._received = bytearray()
        self._stream: list[int] = []
        self.is_streaming = False
        self._next_s = self._moved_s = self.clock.now_s()
        self._counts = [0.0, 0.0]  # left, right
        self._asked_counts = [0.0, 0.0]
        self._wanted = (0, 0, 0, 0)  # velocity, radius, right, left

    def receive(self, data: bytes) -> None:
        """Follow commands; in mode off only START is heard."""
        self._received += data
        while (length := self._command_bytes()) is not None and len(self._received) >= length:
            command = bytes(self._received[:length])
            del self._received[:length]
            self._obey(command[0], command[1:])

    def step(self) -> float | None:
        """Turn the wheels, and send the stream every 15 ms."""
        now_s = self.clock.now_s()
        if not (self.is_streaming and self.mode):
            self._move(now_s)
            return None
        self._next_s = oldest_due(self._next_s, STREAM_PERIOD_S, now_s)
        while now_s >= self._next_s:
            self._move(self._next_s)
            ids = b"".join(bytes([one]) + self._packet(one) for one in self._stream)
            frame = bytes([STREAM_HEADER, len(ids)]) + ids
            self.send(frame + bytes([-sum(frame) & 0xFF]), self._next_s)
            self._next_s += STREAM_PERIOD_S
        self._move(now_s)
        return self._next_s

    def press(self, bumps_and_drops: int) -> None:
        """Set packet 7: bit 0 bump right, 1 bump left, 2 wheel drop right, 3 wheel drop left."""
        self.sensors[7] = bumps_and_drops
        if bumps_and_drops & 0b1100:
            self._leave_safe_mode()

    def see_cliff(self, sees: bool, number: int = 10) -> None:
        """Set a cliff sensor: 9 left, 10 front left, 11 front right, 12 right."""
        self.sensors[number] = int(sees)
        if sees and sum(self.speeds_mm_per_s) > 0:
            self._leave_safe_mode()

    def charge(self, is_on_dock: bool) -> None:
        """Put it on its home base, or take it away."""
        self.sensors[34] = 2 if is_on_dock else 0
        self.sensors[21] = 2 if is_on_dock else 0
        if is_on_dock:
            self._leave_safe_mode()

    def _leave_safe_mode(self) -> None:
        if self.mode == SAFE:
            self._set_mode(PASSIVE)

    def _command_bytes(self) -> int | None:
        """Return the length of the command that has begun; None: its end is not known yet."""
        if not self._received:
            return None
        opcode = self._received[0]
        if opcode in (STREAM, QUERY_LIST):
            return 2 + self._received[1] if len(self._received) > 1 else None
        if opcode == SONG:
            return 3 + 2 * self._received[2] if len(self._received) > 2 else None
        return 1 + OPERANDS.get(opcode, 0)

    def _obey(self, opcode: int, data: bytes) -> None:
        if opcode == RESET:
            self.power_on()
            self.send(b"bl-start\r\nSTR730\r\nbootloader id: #x47183549 82ECCFFF\r\n")
        elif self.mode == OFF and opcode != START:
            return
        elif opcode in MODE_AFTER:
            self._set_mode(MODE_AFTER[opcode])
        elif opcode == BAUD and data[0] < len(BIT_RATES):
            self.bit_rate = BIT_RATES[data[0]]
        elif opcode in (SENSORS, QUERY_LIST):
            asked = data if opcode == SENSORS else data[1:]
            self._move(self.clock.now_s())
            self.send(b"".join(self._packet(one) for one in asked))
        elif opcode == STREAM:
            self._stream, self.is_streaming = list(data[1:]), True
            self._next_s = self.clock.now_s() + STREAM_PERIOD_S
        elif opcode == PAUSE:
            self.is_streaming = data[0] == 1
        elif opcode == SONG:
            self.songs[data[0]] = data[2:]
        elif self.mode != PASSIVE:
            self._actuate(opcode, data)

    def _actuate(self, opcode: int, data: bytes) -> None:
        """Follow a command that is heard in the modes safe and full."""
        self._move(self.clock.now_s())
        if opcode == DRIVE:
            self._drive(_signed(data[:2]), int.from_bytes(data[2:], "big"))
        elif opcode == DRIVE_DIRECT:
            right, left = _signed(data[:2]), _signed(data[2:])
            self.speeds_mm_per_s = (_clamped(right), _clamped(left))
            self._wanted = (*self._wanted[:2], right, left)
        elif opcode == DRIVE_PWM:
            duties = [_signed(part) / 255 for part in (data[:2], data[2:])]
            self.speeds_mm_per_s = (
                _clamped(MAX_SPEED_MM_PER_S * duties[0]),
                _clamped(MAX_SPEED_MM_PER_S * duties[1]),
            )
        elif opcode == LEDS:
            self.leds = data
        elif opcode == PLAY and data[0] in self.songs:
            self.played.append(data[0])

    def _drive(self, speed: int, radius: int) -> None:
        self._wanted = (speed, radius, *self._wanted[2:])
        if radius in STRAIGHT:
            right = left = float(speed)
        elif radius in (0xFFFF, 1):
            right, left = (float(speed), -float(speed)) if radius == 1 else (-float(speed), float(speed))
        else:
            signed = radius - 0x10000 if radius & 0x8000 else radius
            half = WHEEL_BASE_M * 500 / signed
            right, left = speed * (1 + half), speed * (1 - half)
        self.speeds_mm_per_s = (_clamped(right), _clamped(left))

    def _set_mode(self, mode: int) -> None:
        self.mode = mode
        if mode in (OFF, PASSIVE):
            self._move(self.clock.now_s())
            self.speeds_mm_per_s = (0.0, 0.0)

    def _move(self, until_s: float) -> None:
        """Turn the wheels up to a time that is not over for longer than a busy machine makes it."""
        if until_s <= self._moved_s:
            return
        passed_s, self._moved_s = until_s - self._moved_s, until_s
        right, left = (speed / 1000 for speed in self.speeds_mm_per_s)
        speeds = (left + right) / 2, (right - left) / WHEEL_BASE_M
        way_m, turn_rad = self._body.move(*speeds, passed_s, self.clock.true_s(until_s))
        half_m = turn_rad * WHEEL_BASE_M / 2
        self._counts[0] += (way_m - half_m) * COUNTS_PER_M
        self._counts[1] += (way_m + half_m) * COUNTS_PER_M

    def _packet(self, number: int) -> bytes:
        """Return the bytes of a packet, or of a group of packets."""
        if number in GROUPS:
            first, last = GROUPS[number]
            return b"".join(self._packet(one) for one in range(first, last + 1))
        if number in UNUSED:
            return bytes(UNUSED[number])
        size = 2 if number in TWO_BYTES else 1
        value = self._value(number)
        low, high = (
            (-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1) if number in SIGNED else (0, (1 << 8 * size) - 1)
        )
        return min(max(value, low), high).to_bytes(size, "big", signed=number in SIGNED)

    def _value(self, number: int) -> int:
        if number in (19, 20):
            return self._since_asked(number)
        if number in (43, 44):
            count = int(self._counts[number - 43]) & 0xFFFF
            return count - 0x10000 if count & 0x8000 else count
        if number in range(39, 43):
            value = self._wanted[number - 39]
            return value - 0x10000 if value > 0x7FFF else value
        told = {35: self.mode, 37: self.played[-1] if self.played else 0, 38: len(self._stream)}
        return told.get(number, self.sensors.get(number, 0))

    def _since_asked(self, number: int) -> int:
        """Return the distance, mm, or the angle, degrees, since it was asked for last."""
        at = number - 19
        left, right = (count / COUNTS_PER_M for count in self._counts)
        whole = 1000 * (left + right) / 2 if at == 0 else math.degrees((right - left) / WHEEL_BASE_M)
        told = int(whole - self._asked_counts[at])
        self._asked_counts[at] += told
        return told


def _signed(data: bytes) -> int:
    return int.from_bytes(data, "big", signed=True)


def _clamped(speed: float) -> float:
    return min(max(float(speed), -MAX_SPEED_MM_PER_S), MAX_SPEED_MM_PER_S)
