"""The packets of Pioneer robots, whose controllers run ARCOS, AROS or P2OS.

Source: MobileRobots Inc., Pioneer 3 Operations Manual with MobileRobots' ARCOS (2006), chapter 6.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

HEADER = b"\xfa\xfb"
MAX_PACKET_BYTES = 200
# Header, length, number and checksum.
PACKET_BYTES = 6
MAX_TEXT_BYTES = 190


class P2osError(ValueError):
    """A command has a value that does not fit its packet."""


class PioneerCommand(IntEnum):
    """The commands of a client. The handshake's SYNC0, SYNC1 and SYNC2 are the first three."""

    PULSE = 0
    OPEN = 1
    CLOSE = 2
    ENABLE = 4
    ACCELERATION = 5
    MAX_SPEED = 6
    RESET_ORIGIN = 7
    MOVE = 8
    MAX_TURN_RATE = 10
    SPEED = 11
    HEADING = 12
    CONFIG = 18
    TURN_RATE = 21
    TURN_ACCELERATION = 23
    SONAR = 28
    STOP = 29
    DIGITAL_OUT = 30
    WHEEL_SPEEDS = 32
    IO = 40
    BUMP_STALL = 44
    HOST_BAUD = 50
    EMERGENCY_STOP = 55


class PacketId(IntEnum):
    """The packets that a robot sends, by their first byte."""

    CONFIG = 0x20
    STANDING = 0x32
    MOVING = 0x33


class PioneerPacket(NamedTuple):
    """A packet: its number, and the bytes behind."""

    number: int
    data: bytes


def checksum(data: bytes) -> int:
    """Return the checksum: the sum of the big-endian pairs; a last odd byte is combined by exclusive or."""
    pairs = len(data) // 2
    total: int = sum(struct.unpack_from(f">{pairs}H", data)) & 0xFFFF
    return total ^ data[-1] if len(data) % 2 else total


def packet(data: bytes) -> bytes:
    """Return the packet with these contents.

    Raises:
        P2osError: they are empty or too long.
    """
    if not 0 < len(data) <= MAX_PACKET_BYTES - 5:
        raise P2osError(f"a packet has 1 to {MAX_PACKET_BYTES - 5} bytes, not {len(data)}")
    return HEADER + bytes([len(data) + 2]) + data + struct.pack(">H", checksum(data))


def command(number: int, argument: int | str | None = None) -> bytes:
    """Return the packet of a command.

    Args:
        number: the command, such as `PioneerCommand.SPEED`.
        argument: a number from -65535 to 65535, a short text, or nothing.

    Raises:
        P2osError: the argument does not fit.
    """
    if argument is None:
        return packet(bytes([number]))
    if isinstance(argument, str):
        text = argument.encode("latin-1", "replace")
        if len(text) > MAX_TEXT_BYTES:
            raise P2osError(f"a command's text has at most {MAX_TEXT_BYTES} bytes, not {len(text)}")
        return packet(bytes([number, 0x2B, len(text)]) + text)
    if abs(argument) > 0xFFFF:
        raise P2osError(f"a command's argument is at most 65535, not {argument}")
    kind = 0x3B if argument >= 0 else 0x1B
    return packet(struct.pack("<BBH", number, kind, abs(argument)))


class P2osFraming(Framing[PioneerPacket]):
    """The packets of both directions."""

    start = HEADER
    head_bytes = 3

    def length(self, head: bytes) -> int | None:
        """Return the length that the third byte tells."""
        if len(head) < 3:
            return None
        if not 3 <= head[2] <= MAX_PACKET_BYTES - 3:
            raise DamagedFrame(f"a packet of {head[2]} bytes")
        return 3 + head[2]

    def parse(self, frame: bytes) -> PioneerPacket:
        """Return the packet's number and contents."""
        data = frame[3:-2]
        (told,) = struct.unpack(">H", frame[-2:])
        if checksum(data) != told:
            raise DamagedFrame(f"checksum {told:04x} instead of {checksum(data):04x}")
        return PioneerPacket(data[0], data[1:])


class RobotName(NamedTuple):
    """The robot's answer to the last step of the handshake."""

    name: str
    family: str
    model: str


def robot_name(answer: PioneerPacket) -> RobotName:
    """Return the names in the answer to SYNC2.

    Raises:
        DamagedFrame: it is another packet.
    """
    texts = answer.data.split(b"\0")
    if answer.number != 2 or len(texts) < 3:
        raise DamagedFrame(f"packet {answer.number} instead of the robot's name")
    return RobotName(*(text.decode("latin-1") for text in texts[:3]))


@dataclass(frozen=True)
class ServerInformation:
    """The standard packet (SIP) that the robot sends every 100 ms, in the robot's own units.

    Attributes:
        moving: whether the robot moves.
        x: position in the controller's units; it wraps.
        y: likewise.
        heading: in the controller's units, positive to the left.
        left_mm_per_s: speed of the left wheels.
        right_mm_per_s: speed of the right wheels.
        battery_v: voltage of the battery.
        left_stalled: whether the left motors are stalled.
        right_stalled: whether the right motors are stalled.
        front_bumpers: one bit for each front bumper, the lowest is the first.
        rear_bumpers: likewise for the rear.
        motors_enabled: whether the motors have power.
        sonar_mm: distances by the sonars' numbers, only those measured since the last packet.
        charging: the charger's state; None: not told.
    """

    moving: bool
    x: int
    y: int
    heading: int
    left_mm_per_s: int
    right_mm_per_s: int
    battery_v: float
    left_stalled: bool
    right_stalled: bool
    front_bumpers: int
    rear_bumpers: int
    motors_enabled: bool
    sonar_mm: dict[int, int]
    charging: int | None


class Configuration(NamedTuple):
    """The robot's parameters that matter to the driver.

    Attributes:
        top_acceleration_mm_per_s2: no acceleration or deceleration may be greater.
        top_turn_acceleration_deg_per_s2: likewise, of turns.
        report_period_s: a standard packet comes at this interval.
        watchdog_s: the robot stops when it has heard nothing for this time; 0: never.
        deceleration_mm_per_s2: how it brakes.
        turn_deceleration_deg_per_s2: likewise, when it turns.
    """

    top_acceleration_mm_per_s2: int
    top_turn_acceleration_deg_per_s2: int
    report_period_s: float
    watchdog_s: float
    deceleration_mm_per_s2: int
    turn_deceleration_deg_per_s2: int


# Behind the kind, the model and the number of the robot: motors; the greatest speeds (turns first), the
# greatest accelerations (likewise) and the greatest duty of the motors. Then the robot's name.
_CONFIG_START = struct.Struct("<B5H")
# Period of the reports, two bit rates, gripper, sonars at both ends, low battery, counts, watchdog, kind of
# packets, stall, joystick, greatest speeds; accelerations, decelerations and gains: of turns, then ahead.
_CONFIG_END = struct.Struct("<BBBHHBHHHB4HHH5H5H")


def configuration(sent: PioneerPacket) -> Configuration:
    """Return the robot's parameters in the answer to `PioneerCommand.CONFIG`.

    Raises:
        DamagedFrame: it is another packet, or it is too short.
    """
    end = -1
    for _ in range(3):
        end = sent.data.find(b"\0", end + 1)
        if sent.number != PacketId.CONFIG or end < 0:
            raise DamagedFrame(f"packet {sent.number} does not tell the robot's parameters")
    at = end + 1
    named = sent.data.find(b"\0", at + _CONFIG_START.size)
    if named < 0 or len(sent.data) < named + 1 + _CONFIG_END.size:
        raise DamagedFrame(f"the robot's parameters end after {len(sent.data)} bytes")
    _, _, _, top_turn, top, _ = _CONFIG_START.unpack_from(sent.data, at)
    values = _CONFIG_END.unpack_from(sent.data, named + 1)
    return Configuration(top, top_turn, values[0] / 1000, values[8] / 1000, values[22], values[17])


_SIP_START = struct.Struct("<HHhhhBBBhHBB")
_SONAR = struct.Struct("<BH")
# Behind the sonars: gripper, analogue port and value, digital in and out, battery in 0.1 V, charger.
_SIP_END = struct.Struct("<BBBBBHB")


def server_information(sent: PioneerPacket) -> ServerInformation:
    """Return the contents of a standard packet.

    Raises:
        DamagedFrame: it is another packet, or it is too short.
    """
    if sent.number not in (PacketId.STANDING, PacketId.MOVING) or len(sent.data) < _SIP_START.size:
        raise DamagedFrame(f"packet {sent.number} of {len(sent.data)} bytes is no standard packet")
    x, y, heading, left, right, battery, left_bits, right_bits, _, flags, _, sonars = _SIP_START.unpack_from(
        sent.data
    )
    end = _SIP_START.size + sonars * _SONAR.size
    if len(sent.data) < end:
        raise DamagedFrame(f"{sonars} sonars do not fit a packet of {len(sent.data)} bytes")
    battery_v, charging = battery / 10, None
    if len(sent.data) >= end + _SIP_END.size:
        *_, battery_dv, charging = _SIP_END.unpack_from(sent.data, end)
        battery_v = battery_dv / 10 or battery_v
    return ServerInformation(
        moving=sent.number == PacketId.MOVING,
        x=x,
        y=y,
        heading=heading,
        left_mm_per_s=left,
        right_mm_per_s=right,
        battery_v=battery_v,
        left_stalled=bool(left_bits & 1),
        right_stalled=bool(right_bits & 1),
        rear_bumpers=left_bits >> 1,
        front_bumpers=right_bits >> 1,
        motors_enabled=bool(flags & 1),
        sonar_mm=dict(_SONAR.iter_unpack(sent.data[_SIP_START.size : end])),
        charging=charging,
    )
