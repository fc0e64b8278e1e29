"""An emulated Pioneer 3-AT with P2OS or ARCOS.

Source: ActivMedia Robotics, Pioneer 2 / PeopleBot Operations Manual.
"""

import math
import struct
from dataclasses import dataclass, field

from robbie_robots.hw.emulation.body import ObedientBody, WheeledBody
from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice, oldest_due

HEADER = b"\xfa\xfb"
SIP_PERIOD_S = 0.1
WATCHDOG_S = 2.0
BIT_RATES = (9_600, 19_200, 38_400, 57_600, 115_200)
SYNC_ANSWER = b"\x02" + b"Robot\0Pioneer\0"
NOTHING_SEEN_MM = 5000
RADIANS_PER_COUNT = 2 * math.pi / 4096
DIFF_CONV = 0.0034
SPEED_STEP_MM_PER_S = 20
MAX_MM_PER_S, MAX_DEG_PER_S = 1200, 300
# The greatest accelerations, mm/s^2 and degrees/s^2, and those of a robot as it is delivered.
TOP_ACCELERATIONS = (2000, 300)
DELIVERED_ACCELERATIONS = (300, 100)
# Speeds change in steps of this time.
RAMP_STEP_S = 0.01

PULSE, OPEN, CLOSE, ENABLE, SETA, RESET_ORIGIN, SETRA = 0, 1, 2, 4, 5, 7, 23
VEL, CONFIG, RVEL, SONAR, STOP, VEL2, HOST_BAUD, ESTOP = 11, 18, 21, 28, 29, 32, 50, 55


@dataclass
class PioneerState:
    """The state of the robot's body; set it to your liking.

    Attributes:
        subclass: "p3at", or "p3at-sh" with counts of 1 mm.
        mm_per_count: length of a count of x and y.
        count_bits: after how many bits x and y begin again: 15, or 12 in the oldest firmware.
        battery_v: voltage of the battery.
        sonars_mm: ranges of the sonars.
        stalls: of the left and the right wheel.
        bumpers: bits of the front and of the rear bumpers.
        watchdog_s: its parameter WatchDog: it stops when the host is silent for this time.
        bit_rate: its parameter HostBaud, bit/s.
    """

    subclass: str = "p3at"
    mm_per_count: float = 0.465
    count_bits: int = 15
    battery_v: float = 12.6
    sonars_mm: list[int] = field(default_factory=lambda: [NOTHING_SEEN_MM] * 16)
    stalls: tuple[bool, bool] = (False, False)
    bumpers: tuple[int, int] = (0, 0)
    watchdog_s: float = WATCHDOG_S
    bit_rate: int = BIT_RATES[0]


class EmulatedPioneer(EmulatedDevice):
    """A robot that drives as it is told, and stops when it has heard nothing for some time.

    It speeds up and brakes within its accelerations, which a host may change until it disconnects. Only an
    emergency stop brakes harder.

    Args:
        clock: its clock.
        base: its body.
        body: moves as the wheels are told; by default exactly so.

    Attributes:
        velocity: forward, mm/s, and to the left, degrees/s.
        wanted: what it was told.
        accelerations: forward, mm/s^2, and to the left, degrees/s^2; `decelerations` likewise.
        watchdog_stops: how often it stopped because the host fell silent.
    """

    def __init__(
        self,
        clock: EmulatedClock | None = None,
        base: PioneerState | None = None,
        body: WheeledBody | None = None,
    ) -> None:
        super().__init__(clock)
        self.base = base or PioneerState()
        self._body = body or ObedientBody()
        self.velocity = self.wanted = (0.0, 0.0)
        self.power_on()

    def power_on(self) -> None:
        """Wait for a host, motors off, at the origin."""
        self.bit_rate = self.base.bit_rate
        self.watchdog_stops = 0
        self._received = bytearray()
        self._synced, self.is_open = 0, False
        self._heard_s = self._moved_s = self._next_s = self.clock.now_s()
        self._rest()
        self._origin()

    def receive(self, data: bytes) -> None:
        """Follow commands whose checksum is right; ignore all else."""
        self._received += data
        while True:
            start = self._received.find(HEADER)
            if start < 0:
                del self._received[: max(0, len(self._received) - 1)]
                return
            del self._received[:start]
            if len(self._received) < 3 or len(self._received) < 3 + self._received[2]:
                return
            length = 3 + self._received[2]
            body = bytes(self._received[3 : length - 2])
            told = int.from_bytes(self._received[length - 2 : length], "big")
            if self._received[2] < 3 or checksum(body) != told:
                del self._received[:1]
                continue
            del self._received[:length]
            self._heard_s = self.clock.now_s()
            self._obey(body[0], body)

    def step(self) -> float | None:
        """Drive, stop when the host is silent, and send a report every 100 ms."""
        now_s = self.clock.now_s()
        if not self.is_open:
            self._move(now_s)
            return None
        self._next_s = oldest_due(self._next_s, SIP_PERIOD_S, now_s)
        while now_s >= self._next_s:
            self._move_watched(self._next_s)
            self.send(packet(self._report()), self._next_s)
            self._next_s += SIP_PERIOD_S
        self._move_watched(now_s)
        due = [self._next_s]
        due += [self._heard_s + self.base.watchdog_s] if any(self.wanted) else []
        due += [now_s + RAMP_STEP_S] if self.velocity != self.wanted else []
        return min(due)

    def _obey(self, command: int, body: bytes) -> None:
        if not self.is_open:
            self._shake_hands(command, body)
            return
        value = _argument(body)
        self._move(self.clock.now_s())
        if command == CLOSE:
            self.is_open, self._synced = False, 0
            self._rest()
        elif command == ENABLE:
            self.are_motors_on = bool(value)
            self.velocity = self.wanted = (0.0, 0.0)
        elif command == RESET_ORIGIN:
            self._origin()
        elif command == STOP:
            self.wanted = (0.0, 0.0)
        elif command == ESTOP:
            self.velocity = self.wanted = (0.0, 0.0)
        elif command in (SETA, SETRA):
            kind = int(command == SETRA)
            changed = self.accelerations if value > 0 else self.decelerations
            changed[kind] = min(abs(value), TOP_ACCELERATIONS[kind])
        elif command == SONAR:
            self.are_sonars_on = bool(value)
        elif command == HOST_BAUD and 0 <= value < len(BIT_RATES):
            self.bit_rate = BIT_RATES[value]
        elif command == CONFIG:
            self._send(self._configuration())
        elif self.are_motors_on:
            self._drive(command, value)

    def _drive(self, command: int, value: int) -> None:
        forward, turn = self.wanted
        if command == VEL:
            forward = float(value)
        elif command == RVEL:
            turn = float(value)
        elif command == VEL2:
            # The first of the two signed bytes is the left wheel's, the low one the right wheel's.
            left, right = (_signed_byte(value >> shift & 0xFF) * SPEED_STEP_MM_PER_S for shift in (8, 0))
            forward, turn = (left + right) / 2, math.degrees((right - left) / 2 * DIFF_CONV)
        self.wanted = (
            min(max(forward, -MAX_MM_PER_S), MAX_MM_PER_S),
            min(max(turn, -MAX_DEG_PER_S), MAX_DEG_PER_S),
        )

    def _shake_hands(self, command: int, body: bytes) -> None:
        if self._synced < 3:
            # Anything out of order begins the handshake again.
            self._synced = self._synced + 1 if command == self._synced else int(command == 0)
            if command == 2 and self._synced == 3:
                self._send(SYNC_ANSWER + self.base.subclass.encode() + b"\0")
            elif self._synced:
                self._send(body)
        elif command == OPEN:
            self.is_open, self._next_s = True, self.clock.now_s() + SIP_PERIOD_S
        elif command in (PULSE, CLOSE):
            self._synced = 0
            self._obey(command, body)

    def _rest(self) -> None:
        self.velocity = self.wanted = (0.0, 0.0)
        self.accelerations, self.decelerations = list(DELIVERED_ACCELERATIONS), list(DELIVERED_ACCELERATIONS)
        self.are_motors_on, self.are_sonars_on = False, True

    def _origin(self) -> None:
        self._x_mm = self._y_mm = self._heading_rad = 0.0

    def _move_watched(self, until_s: float) -> None:
        """Drive up to a time; brake from when the host has been silent for too long."""
        bites_s = self._heard_s + self.base.watchdog_s
        if until_s >= bites_s and any(self.wanted):
            self._move(bites_s)
            self.wanted = (0.0, 0.0)
            self.watchdog_stops += 1
        self._move(until_s)

    def _move(self, until_s: float) -> None:
        """Drive up to a time that is not over for longer than a busy machine makes it."""
        while until_s > self._moved_s:
            passed_s = until_s - self._moved_s
            if self.velocity != self.wanted:
                passed_s = min(passed_s, RAMP_STEP_S)
                self._ramp(passed_s)
            self._moved_s = min(until_s, self._moved_s + passed_s)
            self._drive_for(passed_s)

    def _ramp(self, passed_s: float) -> None:
        """Come nearer to the wanted speeds."""
        nearer = []
        for kind, (now, wanted) in enumerate(zip(self.velocity, self.wanted, strict=True)):
            brakes = abs(wanted) < abs(now) or now * wanted < 0
            most = (self.decelerations if brakes else self.accelerations)[kind] * passed_s
            nearer.append(now + min(max(wanted - now, -most), most))
        self.velocity = (nearer[0], nearer[1])

    def _drive_for(self, passed_s: float) -> None:
        forward, turn = self.velocity
        at_s = self.clock.true_s(self._moved_s)
        way_m, turned_rad = self._body.move(forward / 1000, math.radians(turn), passed_s, at_s)
        middle = self._heading_rad + turned_rad / 2
        self._x_mm += 1000 * way_m * math.cos(middle)
        self._y_mm += 1000 * way_m * math.sin(middle)
        self._heading_rad += turned_rad

    def _report(self) -> bytes:
        base, (forward, turn) = self.base, self.velocity
        counts = [int(way // base.mm_per_count) % (1 << base.count_bits) for way in (self._x_mm, self._y_mm)]
        theta = round(self._heading_rad / RADIANS_PER_COUNT) % 4096
        differ = math.radians(turn) / DIFF_CONV
        wheels = [round(forward - differ), round(forward + differ)]
        stalls = [
            int(stall) | bits << 1 for stall, bits in zip(base.stalls, reversed(base.bumpers), strict=True)
        ]
        flags = int(self.are_motors_on) | (0b11110 if self.are_sonars_on else 0)
        body = bytes([0x33 if forward or turn else 0x32])
        for value in (*counts, theta, *wheels):
            body += (value & 0xFFFF).to_bytes(2, "little")
        body += bytes([round(base.battery_v * 10), *stalls])
        body += (0).to_bytes(2, "little") + flags.to_bytes(2, "little") + bytes([0])
        seen = list(enumerate(base.sonars_mm)) if self.are_sonars_on else []
        body += bytes([len(seen)])
        for number, range_mm in seen:
            body += bytes([number]) + range_mm.to_bytes(2, "little")
        body += bytes(5) + round(base.battery_v * 10).to_bytes(2, "little") + bytes(1)
        return body + round(10 * turn).to_bytes(2, "little", signed=True) + bytes(2)

    def _configuration(self) -> bytes:
        """Return the contents of the packet CONFIG: bytes, integers of two bytes, and texts."""
        base, (top, turn_top) = self.base, TOP_ACCELERATIONS
        body = b"\x20Pioneer\0" + base.subclass.encode() + b"\0" + b"0001\0"
        # Four motors; the greatest speeds and accelerations, turning first; the greatest duty of the motors.
        body += struct.pack("<B5H", 1, MAX_DEG_PER_S, MAX_MM_PER_S, turn_top, top, 500) + b"Robot\0"
        # Cycle of the reports, bit rates, gripper, sonars, low battery, encoder counts a turn.
        body += struct.pack(
            "<BBBHHBHH", round(1000 * SIP_PERIOD_S), BIT_RATES.index(base.bit_rate), 0, 0, 1, 1, 110, 32550
        )
        # Watchdog, alternative packets, stall, joystick.
        body += struct.pack("<HB4H", round(1000 * base.watchdog_s), 0, 500, 200, 750, 50)
        # Speeds, then accelerations, decelerations and gains of the controllers of turns and of the way.
        (speed_up, turn_up), (brake, turn_brake) = self.accelerations, self.decelerations
        body += struct.pack("<HH5H5H", 100, 750, turn_up, turn_brake, 40, 20, 0, speed_up, brake, 40, 30, 0)
        # Bumpers at the front and at the rear, charger, sonar cycle, automatic bit rate, gyroscope.
        return body + bytes([5, 5, 0, 40, 0, 0])

    def _send(self, body: bytes) -> None:
        self.send(packet(body))


def checksum(body: bytes) -> int:
    """Return the checksum: the sum of pairs of bytes; a last odd byte changes it by exclusive or."""
    total = 0
    for at in range(0, len(body) - 1, 2):
        total = total + (body[at] << 8 | body[at + 1]) & 0xFFFF
    return total ^ body[-1] if len(body) % 2 else total


def packet(body: bytes) -> bytes:
    """Return a packet with header, length and checksum."""
    return HEADER + bytes([len(body) + 2]) + body + checksum(body).to_bytes(2, "big")


def _argument(body: bytes) -> int:
    """Return a command's number: 3B positive, 1B negative."""
    if len(body) < 4 or body[1] not in (0x3B, 0x1B):
        return 0
    value = int.from_bytes(body[2:4], "little")
    return -value if body[1] == 0x1B else value


def _signed_byte(value: int) -> int:
    return value - 256 if value & 0x80 else value
