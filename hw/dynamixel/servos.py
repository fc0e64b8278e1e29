"""Dynamixel servos of the X and P series and MX with protocol 2.0, on one serial line.

Source: Robotis, e-Manual of the X series (control table) and Dynamixel Protocol 2.0.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from typing_extensions import Unpack

from robbie_mp.base.device_links import monotonic
from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.dynamixel import protocol2
from robbie_robots.hw.dynamixel.protocol2 import Packet2, Protocol2Framing, Status
from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.joints import Joint, JointReading, Joints, capped_validity_s, checked

BIT_RATE = 57_600
STEPS_PER_TURN = 4096
RAD_PER_STEP = 2 * math.pi / STEPS_PER_TURN
RAD_PER_S_PER_UNIT = 0.229 * 2 * math.pi / 60
# Addresses of the control table.
TORQUE_ENABLE, HARDWARE_ERROR, BUS_WATCHDOG, PROFILE_VELOCITY, GOAL_POSITION = 64, 70, 98, 112, 116
PRESENT_VELOCITY = 128
INDIRECT_ADDRESSES, INDIRECT_DATA = 168, 224
# What each servo shows in a row: its hardware error, its watchdog, its goal, its velocity and its position.
SHOWN = (
    HARDWARE_ERROR,
    BUS_WATCHDOG,
    *range(GOAL_POSITION, GOAL_POSITION + 4),
    *range(PRESENT_VELOCITY, PRESENT_VELOCITY + 8),
)
_SHOWN = struct.Struct("<BBiii")
_SHOWN_ADDRESSES = struct.pack(f"<{len(SHOWN)}H", *SHOWN)
WATCHDOG_UNIT_S = 0.02
# What a watchdog shows after it has stopped its servo.
WATCHDOG_ENDED = 255
ANSWER_S = 0.1
ATTEMPTS = 3
HARDWARE_ERRORS = {
    0x01: "input voltage", 0x04: "overheated", 0x08: "encoder", 0x10: "electrical shock", 0x20: "overloaded",
}  # fmt: skip


@dataclass(frozen=True)
class ServoJoint(Joint):
    """A joint that a servo moves.

    Attributes:
        servo: the servo's number on the line.
        zero_step: position of the servo, in steps of 1/4096 turn, where the joint is at 0.
        is_reversed: whether the joint turns against the servo.
    """

    servo: int = 1
    zero_step: int = STEPS_PER_TURN // 2
    is_reversed: bool = False

    def steps(self, position_rad: float) -> int:
        """Return the servo's steps for a position."""
        sign = -1 if self.is_reversed else 1
        return self.zero_step + sign * round(position_rad / RAD_PER_STEP)

    def position_rad(self, steps: int) -> float:
        """Return the position for the servo's steps."""
        return (steps - self.zero_step) * RAD_PER_STEP * (-1 if self.is_reversed else 1)


class _Settings(NamedTuple):
    """The settings of a servo at a start."""

    torque: int
    watchdog: int
    velocity: int


class DynamixelJoints(PluggableDevice[JointReading], Joints):
    """Joints on Dynamixel servos. `poll` returns their states, at `rate_hz`.

    When a command expires, the driver switches the torque off. If this process dies or hangs, or the cable
    is pulled, each servo's own bus watchdog stops it after `watchdog_s`, and it holds its position. When the
    line works again, the driver switches the torque off. Only the next command moves a servo then.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        servos: the joints.
        bit_rate: bit/s of the line.
        rate_hz: readings each second.
        watchdog_s: a servo stops when the line is silent for this time: 0.02 to 2.54.
        options: see `DeviceOptions`.

    Example:
        with closing(DynamixelJoints("/dev/ttyUSB0", [ServoJoint("gripper", servo=1)])) as gripper:
            gripper.poll(1.0)
            gripper.command({"gripper": 0.3}, valid_for_s=0.5)
    """

    SILENCE_S = 0.5

    def __init__(
        self,
        url: str,
        servos: Sequence[ServoJoint],
        bit_rate: int = BIT_RATE,
        *,
        rate_hz: float = 50.0,
        watchdog_s: float = 0.2,
        **options: Unpack[DeviceOptions],
    ) -> None:
        numbers = [joint.servo for joint in servos]
        if not numbers or len(set(numbers)) < len(numbers) or not all(0 <= one <= 252 for one in numbers):
            raise ValueError(f"each joint needs a servo with a number of 0 to 252, not {numbers}")
        units = round(watchdog_s / WATCHDOG_UNIT_S)
        if not 1 <= units <= 127:
            raise ValueError(f"watchdog_s must be 0.02 to 2.54, not {watchdog_s:g}")
        super().__init__(url, bit_rate, **options)
        self.expired_commands = 0
        """How many commands have ended because no newer one came in time."""
        self.watchdog_stops = 0
        """How often servos were found stopped by their own watchdogs."""
        self._servos = tuple(servos)
        self._numbers, self._watchdog_units = numbers, units
        self._period_s = 1.0 / rate_hz
        self._decoder = FrameDecoder(Protocol2Framing())
        self._answered: dict[int, Status] = {}
        self._goals: dict[int, int] = {}
        """The goals of the servos since their torque is on, in steps."""
        self._goals_when_asked: dict[int, int] = {}
        self._next_s = -math.inf
        self._valid_until_s: float | None = None
        self._has_torque = False

    @property
    def joints(self) -> Sequence[ServoJoint]:
        """Return the joints."""
        return self._servos

    @property
    def has_torque(self) -> bool:
        """Return whether the servos' torque is on."""
        return self._has_torque

    def command(self, positions_rad: Mapping[str, float], valid_for_s: float) -> None:
        """Move joints to positions; without a connection nothing happens."""
        goals = checked(self._servos, positions_rad, valid_for_s)
        until_s = self._monotonic() + capped_validity_s(valid_for_s)
        if not self.is_connected or not goals:
            return
        if not self._has_torque:
            # A servo whose torque comes on keeps its position: its goal becomes what it measures.
            self.send(protocol2.sync_write(TORQUE_ENABLE, self._for_all(b"\1")))
            self._has_torque = True
        steps = {self._servos[place].servo: self._servos[place].steps(goal) for place, goal in goals.items()}
        self._goals |= steps
        written = {servo: struct.pack("<i", goal) for servo, goal in steps.items()}
        self._valid_until_s = until_s
        # This process may have been stopped meanwhile, or be stopped in the middle of the write.
        if not self._release_expired():
            self.send(protocol2.sync_write(GOAL_POSITION, written))
            self._release_expired()

    def release(self) -> None:
        """Switch the torque of all servos off."""
        self._valid_until_s, self._has_torque = None, False
        self._goals.clear()
        self.send(protocol2.sync_write(TORQUE_ENABLE, self._for_all(b"\0")))

    def poll(self, wait_s: float = 0.0) -> list[JointReading]:
        """Return the states since the last call; let the joints go when a command has expired."""
        now_s = self._monotonic()
        if self.is_connected and now_s >= self._next_s:
            self._next_s = max(self._next_s + self._period_s, now_s)
            self._answered.clear()
            # The servos obey in order: when they answer, they have these goals, or have refused them.
            self._goals_when_asked = dict(self._goals)
            self.send(protocol2.sync_read(INDIRECT_DATA, len(SHOWN), self._numbers))
        due_s = self._next_s if self.is_connected else now_s + wait_s
        if self._valid_until_s is not None:
            due_s = min(due_s, self._valid_until_s)
        readings = super().poll(max(0.0, min(wait_s, due_s - now_s)))
        self._release_expired()
        return readings

    def _release_expired(self) -> bool:
        """Let the joints go if their command has expired. Return whether it has."""
        has_expired = self._valid_until_s is not None and self._monotonic() >= self._valid_until_s
        if has_expired:
            self.expired_commands += 1
            self.release()
        return has_expired

    def _start(self, port: Port) -> None:
        """Switch the torque off and tell the servos what to show, until all have taken their settings."""
        port.drain(quiet_s=0.01, limit_s=0.1)
        wanted = {joint.servo: self._settings(joint) for joint in self._servos}
        for _ in range(ATTEMPTS):
            for address, data in self._setup():
                port.write(protocol2.sync_write(address, data))
            taken = self._ask_all(port, TORQUE_ENABLE, GOAL_POSITION - TORQUE_ENABLE)
            shown = self._ask_all(port, INDIRECT_ADDRESSES, len(_SHOWN_ADDRESSES))
            silent = [servo for servo in self._numbers if servo not in taken or servo not in shown]
            differing = [
                servo
                for servo in self._numbers
                if servo not in silent
                and (_settings_of(taken[servo]) != wanted[servo] or shown[servo] != _SHOWN_ADDRESSES)
            ]
            if not silent and not differing:
                return
        if silent:
            raise DeviceSilent(f"servo {silent[0]} at {self.url} does not answer at {self.bit_rate} bit/s")
        raise DeviceFault(
            f"servo {differing[0]} at {self.url} does not take its settings: is its velocity limit below "
            f"{wanted[differing[0]].velocity} units?"
        )

    def _settings(self, joint: ServoJoint) -> "_Settings":
        speed = max(1, round(joint.speed_rad_per_s / RAD_PER_S_PER_UNIT))
        return _Settings(torque=0, watchdog=self._watchdog_units, velocity=speed)

    def _setup(self) -> list[tuple[int, dict[int, bytes]]]:
        """Return what is written at a start: addresses, and the bytes for each servo."""
        speeds = {joint.servo: struct.pack("<I", self._settings(joint).velocity) for joint in self._servos}
        return [
            # A watchdog that has stopped a servo refuses all goals until it is cleared.
            (BUS_WATCHDOG, self._for_all(b"\0")),
            (TORQUE_ENABLE, self._for_all(b"\0")),
            (INDIRECT_ADDRESSES, self._for_all(_SHOWN_ADDRESSES)),
            (PROFILE_VELOCITY, speeds),
            (BUS_WATCHDOG, self._for_all(bytes([self._watchdog_units]))),
        ]

    def _for_all(self, data: bytes) -> dict[int, bytes]:
        return dict.fromkeys(self._numbers, data)

    def _ask_all(self, port: Port, address: int, length: int) -> dict[int, bytes]:
        """Read the same bytes of all servos at once; those that are silent are missing."""
        port.write(protocol2.sync_read(address, length, self._numbers))
        answers: dict[int, bytes] = {}
        end_s = monotonic() + ANSWER_S
        while len(answers) < len(self._numbers) and (left_s := end_s - monotonic()) > 0:
            data = port.read(left_s)
            if data:
                end_s = monotonic() + ANSWER_S
            for packet in self._decoder.feed(data):
                # A line of two wires may repeat what we send: a request is no answer.
                answer = _status(packet)
                if answer is not None and answer.servo in self._numbers and len(answer.data) == length:
                    answers[answer.servo] = answer.data
        return answers

    def _take(self, data: bytes) -> list[JointReading]:
        readings = []
        for packet in self._decoder.feed(data):
            answer = _status(packet)
            if answer is None or answer.servo not in self._numbers or len(answer.data) != _SHOWN.size:
                continue
            self._answered[answer.servo] = answer
            if len(self._answered) == len(self._numbers):
                readings.append(self._reading())
                self._answered.clear()
        self.counters.damaged = self._decoder.damaged
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        return readings

    def _reading(self) -> JointReading:
        positions, speeds, problems = [], [], []
        is_stopped = False
        for joint in self._servos:
            error, watchdog, goal, velocity, position = _SHOWN.unpack(self._answered[joint.servo].data)
            is_stopped = is_stopped or watchdog == WATCHDOG_ENDED
            wanted = self._goals_when_asked.get(joint.servo, goal)
            if goal != wanted and watchdog != WATCHDOG_ENDED:
                problems.append(f"{joint.name}: does not take the goal {wanted}; what are its limits?")
            positions.append(joint.position_rad(position))
            sign = -1 if joint.is_reversed else 1
            speeds.append(sign * velocity * RAD_PER_S_PER_UNIT)
            problems += [f"{joint.name}: {text}" for bit, text in HARDWARE_ERRORS.items() if error & bit]
        if is_stopped:
            self._recover()
        return JointReading(self._clock(), tuple(positions), tuple(speeds), tuple(problems))

    def _recover(self) -> None:
        """Let all joints go and clear the watchdogs: a stopped servo refuses all goals."""
        self.watchdog_stops += 1
        self.release()
        for units in (0, self._watchdog_units):
            self.send(protocol2.sync_write(BUS_WATCHDOG, self._for_all(bytes([units]))))

    def _reset(self) -> None:
        self._decoder.reset()
        self._answered.clear()
        self._goals.clear()
        self._valid_until_s, self._has_torque = None, False
        self._next_s = -math.inf

    def _stop(self) -> None:
        self.release()


def _settings_of(table: bytes) -> _Settings:
    """Return the settings in the part of a servo's table from its torque to its velocity."""
    (velocity,) = struct.unpack_from("<I", table, PROFILE_VELOCITY - TORQUE_ENABLE)
    return _Settings(table[0], table[BUS_WATCHDOG - TORQUE_ENABLE], velocity)


def _status(packet: Packet2) -> Status | None:
    try:
        return protocol2.status(packet)
    except DamagedFrame:
        return None
