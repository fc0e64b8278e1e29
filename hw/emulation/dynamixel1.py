"""Emulated Dynamixel servos with protocol 1.0, on one line: what the driver asks of them.

Source: Robotis, e-Manual: Dynamixel Protocol 1.0, and the control tables of AX-12A and MX-28.
"""

from collections.abc import Mapping

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice

EVERYBODY = 0xFE
PING, READ, WRITE, SYNC_WRITE, BULK_READ = 1, 2, 3, 0x83, 0x92
ANGLE_LIMIT, RANGE, CHECKSUM, INSTRUCTION = 2, 8, 16, 64
TABLE_BYTES = 50
NUMBER, BAUD, CW_LIMIT, CCW_LIMIT, ANSWERS_TO = 3, 4, 6, 8, 16
TORQUE, GOAL, SPEED, TORQUE_LIMIT = 24, 30, 32, 34
POSITION, PRESENT_SPEED, LOAD, VOLTAGE, TEMPERATURE, MOVING = 36, 38, 40, 42, 43, 46
READ_ONLY = (0, 1, 2, *range(POSITION, MOVING + 1))
EEPROM_END = 24
# Steps in a turn, the greatest position, and the speed of 1 in steps per second, by the model's number.
AX_12, MX_28 = 12, 29
SHAPES = {
    AX_12: (1023, 0.111 * 360 / 60 / (300 / 1023)),
    MX_28: (4095, 0.114 * 4096 / 60),
}
STEP_S = 0.02
MAX_PACKET_BYTES = 253 + 4


class OldServo:
    """One servo: its control table, and the joint that it turns.

    Attributes:
        table: the bytes of the control table.
        steps: where the shaft is.
        errors: bits of its status that stay set: voltage 1, overheated 4, overloaded 32.
    """

    def __init__(self, number: int, model: int = AX_12) -> None:
        self.number, self.model = number, model
        self.greatest, self.steps_per_s = SHAPES[model]
        self.steps = float(self.greatest // 2 + 1)
        self.errors = 0
        self.power_on()

    def power_on(self) -> None:
        """Start with the maker's values, torque off."""
        self.table = bytearray(TABLE_BYTES)
        self.put(0, self.model)
        self.table[2], self.table[NUMBER], self.table[BAUD], self.table[5] = 24, self.number, 1, 250
        self.put(CCW_LIMIT, self.greatest)
        self.table[11], self.table[12], self.table[13] = 70, 60, 140
        self.put(14, 1023)
        self.table[ANSWERS_TO] = 2
        self.put(TORQUE_LIMIT, 1023)
        self.table[VOLTAGE], self.table[TEMPERATURE] = 120, 30
        self.put(GOAL, round(self.steps))
        self.put(POSITION, round(self.steps))

    def get(self, address: int) -> int:
        """Return a number of two bytes."""
        return self.table[address] | self.table[address + 1] << 8

    def put(self, address: int, value: int) -> None:
        """Set a number of two bytes."""
        self.table[address : address + 2] = value.to_bytes(2, "little")

    def turn(self, passed_s: float) -> None:
        """Move towards the goal while the torque is on."""
        missing = self.get(GOAL) - self.steps if self.table[TORQUE] else 0.0
        most = (self.get(SPEED) or 1023) * self.steps_per_s * passed_s
        way = max(-most, min(most, missing))
        self.steps += way
        self.put(POSITION, round(self.steps))
        units = round(abs(way) / passed_s / self.steps_per_s)
        self.put(PRESENT_SPEED, min(units, 1023) | (0x400 if way < 0 else 0))
        self.table[MOVING] = int(bool(way))

    def read(self, address: int, length: int) -> bytes | None:
        """Return bytes of the table; None if there are none at these addresses."""
        return bytes(self.table[address : address + length]) if address + length <= TABLE_BYTES else None

    def write(self, address: int, data: bytes) -> int:
        """Write into the table. Return the bits of the error, or 0."""
        places = range(address, address + len(data))
        if not data or address + len(data) > TABLE_BYTES or any(place in READ_ONLY for place in places):
            return RANGE
        before = bytes(self.table)
        self.table[address : address + len(data)] = data
        if GOAL in places:
            is_wheel = self.get(CW_LIMIT) == self.get(CCW_LIMIT) == 0
            if not is_wheel and not self.get(CW_LIMIT) <= self.get(GOAL) <= self.get(CCW_LIMIT):
                self.table[:] = before
                return ANGLE_LIMIT
            # A goal switches the torque on.
            self.table[TORQUE] = 1
        return 0


class EmulatedOldServos(EmulatedDevice):
    """Servos with protocol 1.0 in a chain.

    Args:
        models: the number of each servo's model, by the servo's own number.
        clock: their clock.
        echoes: the line has two wires and repeats what the host sends.

    Attributes:
        servos: the servos by their numbers.
    """

    def __init__(
        self, models: Mapping[int, int], clock: EmulatedClock | None = None, echoes: bool = False
    ) -> None:
        super().__init__(clock)
        self.servos = {number: OldServo(number, model) for number, model in models.items()}
        self.echoes = echoes
        self.power_on()

    def power_on(self) -> None:
        """Start at 1,000,000 bit/s with the maker's values, torque off."""
        self.bit_rate = 1_000_000
        self._received = bytearray()
        self._moved_s = self.clock.now_s()
        for servo in self.servos.values():
            servo.power_on()

    def receive(self, data: bytes) -> None:
        """Obey instruction packets."""
        if self.echoes:
            self.send(bytes(data))
        self._received += data
        while (start := self._received.find(b"\xff\xff")) >= 0:
            del self._received[:start]
            if len(self._received) < 4:
                return
            length = self._received[3] + 4
            if self._received[2] == 0xFF or length < 6:
                del self._received[:1]
                continue
            if len(self._received) < length:
                return
            packet = bytes(self._received[:length])
            if checksum(packet[2:-1]) != packet[-1]:
                self._answer(packet[2], CHECKSUM)
                del self._received[:1]
                continue
            del self._received[:length]
            self._turn()
            self._obey(packet[2], packet[4], packet[5:-1])
        del self._received[: max(0, len(self._received) - 1)]

    def step(self) -> float | None:
        """Turn the joints."""
        self._turn()
        return self.clock.now_s() + STEP_S

    def _turn(self) -> None:
        now_s = self.clock.now_s()
        passed_s, self._moved_s = now_s - self._moved_s, now_s
        if passed_s > 0:
            for servo in self.servos.values():
                servo.turn(passed_s)

    def _obey(self, number: int, instruction: int, data: bytes) -> None:
        if instruction == SYNC_WRITE and number == EVERYBODY and len(data) > 2:
            address, length = data[0], data[1]
            for at in range(2, len(data), 1 + length):
                if data[at] in self.servos:
                    self.servos[data[at]].write(address, data[at + 1 : at + 1 + length])
        elif instruction == BULK_READ and number == EVERYBODY:
            for length, one, address in zip(data[1::3], data[2::3], data[3::3], strict=False):
                if one in self.servos and self.servos[one].model == MX_28:
                    self._read(self.servos[one], address, length)
        else:
            for servo in self.servos.values():
                if number in (servo.number, EVERYBODY):
                    self._obey_alone(servo, instruction, data, number == EVERYBODY)

    def _obey_alone(self, servo: OldServo, instruction: int, data: bytes, is_for_all: bool) -> None:
        if instruction == READ and len(data) == 2 and not is_for_all:
            self._read(servo, data[0], data[1])
            return
        error = 0
        if instruction == WRITE and data:
            error = servo.write(data[0], data[1:])
        elif instruction != PING:
            error = INSTRUCTION
        # A ping is always answered, other instructions only if the servo was told so.
        if not is_for_all and (instruction == PING or servo.table[ANSWERS_TO] == 2):
            self._answer(servo.number, error)

    def _read(self, servo: OldServo, address: int, length: int) -> None:
        if servo.table[ANSWERS_TO]:
            data = servo.read(address, length)
            self._answer(servo.number, RANGE if data is None else 0, data or b"")

    def _answer(self, number: int, error: int, data: bytes = b"") -> None:
        if number in self.servos:
            body = bytes([number, len(data) + 2, error | self.servos[number].errors]) + data
            self.send(b"\xff\xff" + body + bytes([checksum(body)]))


def checksum(data: bytes) -> int:
    """Return the inverted sum of bytes."""
    return 255 - sum(data) % 256
