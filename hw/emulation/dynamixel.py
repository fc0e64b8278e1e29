"""Emulated Dynamixel servos of the X series with protocol 2.0, on one line: what the driver asks of them.

Source: Robotis, e-Manual: Dynamixel Protocol 2.0, and the control table of the X series.
"""

import struct
from collections.abc import Sequence

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice

HEADER = b"\xff\xff\xfd\x00"
EVERYBODY = 0xFE
PING, READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE = 1, 2, 3, 0x55, 0x82, 0x83
RESULT_FAIL, INSTRUCTION_ERROR, CRC_ERROR, RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, ACCESS_ERROR = range(1, 8)
ALERT = 0x80
TABLE_BYTES = 661
EEPROM_END = 64
TORQUE, ERRORS, WATCHDOG, PROFILE_VELOCITY, GOAL, MOVING = 64, 70, 98, 112, 116, 122
VELOCITY, POSITION, VOLTAGE, TEMPERATURE = 128, 132, 144, 146
MAX_LIMIT, MIN_LIMIT = 48, 52
READ_ONLY = (*range(7), ERRORS, MOVING, 123, *range(VELOCITY, 147))
INDIRECT, INDIRECT_DATA, INDIRECT_BYTES = 168, 224, 28
WATCHDOG_ENDED = 0xFF
WATCHDOG_UNIT_S = 0.02
STEPS_PER_S_PER_UNIT = 0.229 * 4096 / 60
MODEL, FIRMWARE = 1030, 38
STEP_S = 0.02
MAX_PACKET_BYTES = 1024


class Servo:
    """One servo: its control table, and the joint that it turns.

    Attributes:
        table: the bytes of the control table.
        steps: where the shaft is, in steps of 1/4096 turn.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.steps = 2048.0
        self.power_on()

    def power_on(self) -> None:
        """Start with the maker's values, torque off."""
        self.table = bytearray(TABLE_BYTES)
        self.table[0:2] = MODEL.to_bytes(2, "little")
        self.table[6], self.table[7] = FIRMWARE, self.number
        self.put(MAX_LIMIT, 4095)
        self.put(VOLTAGE, 120, 2)
        self.table[TEMPERATURE] = 30
        for place in range(INDIRECT_BYTES):
            self.put(INDIRECT + 2 * place, INDIRECT_DATA + place, 2)
        self.put(POSITION, round(self.steps))
        self.heard_s = 0.0

    def get(self, address: int, size: int = 4) -> int:
        """Return a signed number of the table."""
        return int.from_bytes(self.table[address : address + size], "little", signed=True)

    def put(self, address: int, value: int, size: int = 4) -> None:
        """Set a number of the table."""
        self.table[address : address + size] = (value & (1 << 8 * size) - 1).to_bytes(size, "little")

    def turn(self, passed_s: float) -> None:
        """Move towards the goal while the torque is on."""
        fastest = self.get(PROFILE_VELOCITY) or 300
        missing = self.get(GOAL) - self.steps if self.table[TORQUE] and not self.is_halted else 0.0
        most = fastest * STEPS_PER_S_PER_UNIT * passed_s
        way = max(-most, min(most, missing))
        self.steps += way
        self.put(POSITION, round(self.steps))
        moved_units = way / passed_s / STEPS_PER_S_PER_UNIT if passed_s else 0.0
        self.put(VELOCITY, round(moved_units))
        self.table[MOVING] = int(bool(way))

    @property
    def is_halted(self) -> bool:
        """Return whether the bus watchdog has stopped the servo."""
        return self.table[WATCHDOG] == WATCHDOG_ENDED

    def watch(self, now_s: float) -> None:
        """Stop if the bus has been silent for too long."""
        units = self.table[WATCHDOG]
        if 0 < units < WATCHDOG_ENDED and now_s - self.heard_s > units * WATCHDOG_UNIT_S:
            self.table[WATCHDOG] = WATCHDOG_ENDED

    def read(self, address: int, length: int) -> bytes | None:
        """Return bytes of the table; None if there are none at these addresses."""
        if address + length > TABLE_BYTES:
            return None
        return bytes(self.table[self._behind(at)] for at in range(address, address + length))

    def write(self, address: int, data: bytes) -> int:
        """Write into the table. Return the number of the error, or 0."""
        if not data or address + len(data) > TABLE_BYTES:
            return RANGE_ERROR if data else LENGTH_ERROR
        places = [self._behind(at) for at in range(address, address + len(data))]
        if any(place in READ_ONLY for place in places):
            return ACCESS_ERROR
        if self.table[TORQUE] and any(place < EEPROM_END for place in places):
            return ACCESS_ERROR
        if self.is_halted and any(GOAL <= place < GOAL + 4 for place in places):
            return RANGE_ERROR
        before, had_torque = bytes(self.table), self.table[TORQUE]
        for place, byte in zip(places, data, strict=True):
            self.table[place] = byte
        if not self.get(MIN_LIMIT) <= self.get(GOAL) <= self.get(MAX_LIMIT) and GOAL in places:
            self.table[:] = before
            return RANGE_ERROR
        if self.table[TORQUE] and not had_torque:
            self.put(GOAL, round(self.steps))
        return 0

    def _behind(self, address: int) -> int:
        """Return the address that an indirect one stands for."""
        place = address - INDIRECT_DATA
        return self.get(INDIRECT + 2 * place, 2) if 0 <= place < INDIRECT_BYTES else address


class EmulatedServos(EmulatedDevice):
    """Servos in a chain, with the numbers you choose.

    Args:
        numbers: the servos' numbers.
        clock: their clock.

    Attributes:
        servos: the servos by their numbers.
    """

    def __init__(self, numbers: Sequence[int], clock: EmulatedClock | None = None) -> None:
        super().__init__(clock)
        self.servos = {number: Servo(number) for number in numbers}
        self.power_on()

    def power_on(self) -> None:
        """Start at 57,600 bit/s with the maker's values, torque off."""
        self.bit_rate = 57_600
        self._received = bytearray()
        self._moved_s = self.clock.now_s()
        for servo in self.servos.values():
            servo.power_on()
            servo.heard_s = self._moved_s

    def receive(self, data: bytes) -> None:
        """Obey instruction packets; a packet with a wrong CRC is answered so, or not at all."""
        self._received += data
        while (start := self._received.find(HEADER)) >= 0:
            del self._received[:start]
            if len(self._received) < 7:
                return
            length = 7 + int.from_bytes(self._received[5:7], "little")
            if not 10 <= length <= MAX_PACKET_BYTES:
                del self._received[:1]
                continue
            if len(self._received) < length:
                return
            packet = bytes(self._received[:length])
            if crc16(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
                self._answer(packet[4], CRC_ERROR)
                del self._received[:1]
                continue
            del self._received[:length]
            contents = packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            self._turn()
            for servo in self.servos.values():
                servo.heard_s = self.clock.now_s()
            self._obey(packet[4], contents[0], contents[1:])
        del self._received[: max(0, len(self._received) - 3)]

    def step(self) -> float | None:
        """Turn the joints, and stop those whose bus is silent."""
        self._turn()
        return self.clock.now_s() + STEP_S

    def _turn(self) -> None:
        now_s = self.clock.now_s()
        passed_s, self._moved_s = max(0.0, now_s - self._moved_s), now_s
        for servo in self.servos.values():
            servo.watch(now_s)
            if passed_s:
                servo.turn(passed_s)

    def _obey(self, number: int, instruction: int, data: bytes) -> None:
        if instruction == SYNC_READ:
            address, length = struct.unpack_from("<HH", data)
            for one in data[4:]:
                self._read(one, address, length)
        elif instruction == SYNC_WRITE:
            address, length = struct.unpack_from("<HH", data)
            for at in range(4, len(data), 1 + length):
                if data[at] in self.servos:
                    self.servos[data[at]].write(address, data[at + 1 : at + 1 + length])
        else:
            for one in list(self.servos) if number == EVERYBODY else [number]:
                if one in self.servos:
                    self._obey_alone(self.servos[one], instruction, data, number == EVERYBODY)

    def _obey_alone(self, servo: Servo, instruction: int, data: bytes, is_for_all: bool) -> None:
        if instruction == PING:
            self._answer(servo.number, 0, MODEL.to_bytes(2, "little") + bytes([FIRMWARE]))
            return
        if instruction == READ and len(data) == 4 and not is_for_all:
            self._read(servo.number, *struct.unpack("<HH", data))
            return
        error = INSTRUCTION_ERROR
        if instruction == WRITE and len(data) > 2:
            error = servo.write(int.from_bytes(data[:2], "little"), data[2:])
        if not is_for_all:
            self._answer(servo.number, error)

    def _read(self, number: int, address: int, length: int) -> None:
        if number in self.servos:
            data = self.servos[number].read(address, length)
            self._answer(number, RANGE_ERROR if data is None else 0, data or b"")

    def _answer(self, number: int, error: int, data: bytes = b"") -> None:
        if number not in self.servos:
            return
        alert = ALERT if self.servos[number].table[ERRORS] else 0
        contents = bytes([STATUS, error | alert]) + data
        contents = contents.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = HEADER + bytes([number]) + (len(contents) + 2).to_bytes(2, "little") + contents
        self.send(packet + crc16(packet).to_bytes(2, "little"))


def crc16(data: bytes) -> int:
    """Return the checksum: polynomial 8005 hex, from the highest bit, start 0."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1) ^ (0x8005 if value & 0x8000 else 0)
        value &= 0xFFFF
    return value
