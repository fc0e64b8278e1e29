"""Dynamixel servos of the AX, RX, EX and older MX series, with protocol 1.0, on one serial line.

Source: Robotis, e-Manual: AX-12A, RX-28, EX-106+, MX-28 (control tables), and Dynamixel Protocol 1.0.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from typing_extensions import Unpack

from robbie_mp.base.device_links import monotonic
from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.connection.stop_guard import PING_PERIOD_S, StopGuards
from robbie_robots.hw.dynamixel import protocol1
from robbie_robots.hw.dynamixel.protocol1 import Packet1, Protocol1Framing, ServoError
from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.joints import Joint, JointReading, Joints, capped_validity_s, checked

BIT_RATE = 1_000_000
# Addresses of the control table.
MODEL, TORQUE_ENABLE, GOAL_POSITION, MOVING_SPEED = 0, 24, 30, 32
# From the model number to the limits of the position.
_IDENTITY = struct.Struct("<HBBBBHH")
# From the torque to the temperature.
_STATE = struct.Struct("<B5xHHHHHHBB")
SPEED_BITS, BACKWARDS = 0x3FF, 0x400
MAX_SPEED = 1023
ANSWER_S = 0.05
ATTEMPTS = 3
PROBLEMS = {
    ServoError.VOLTAGE: "input voltage",
    ServoError.OVERHEATED: "overheated",
    ServoError.OVERLOADED: "overloaded",
}


@dataclass(frozen=True)
class ServoModel:
    """How a series of servos counts.

    Attributes:
        steps: positions from 0 up to this number, without it.
        range_rad: angle from the first position to the last.
        rad_per_s: unit of its speeds.
    """

    steps: int
    range_rad: float
    rad_per_s: float

    @property
    def rad_per_step(self) -> float:
        """Return the angle between two positions."""
        return self.range_rad / (self.steps - 1)


_AX = ServoModel(1024, math.radians(300.0), 0.111 * math.tau / 60)
_MX = ServoModel(4096, math.tau * 4095 / 4096, 0.114 * math.tau / 60)
_EX = ServoModel(4096, math.radians(251.0), 0.111 * math.tau / 60)
# AX-12, AX-18, AX-12W, RX-10, RX-24F, RX-28, RX-64; MX-12W, MX-28, MX-64, MX-106; EX-106+.
MODELS = {
    **dict.fromkeys((12, 18, 300, 10, 24, 28, 64), _AX),
    **dict.fromkeys((360, 29, 310, 320), _MX),
    107: _EX,
}


@dataclass(frozen=True)
class Protocol1Joint(Joint):
    """A joint that a servo with protocol 1.0 moves.

    Attributes:
        servo: the servo's number on the line.
        zero_step: position of the servo where the joint is at 0; None: the middle of its range.
        is_reversed: whether the joint turns against the servo.
    """

    servo: int = 1
    zero_step: int | None = None
    is_reversed: bool = False


@dataclass
class _Servo:
    """A joint, and what its servo has reported at the last connection and since.

    Attributes:
        joint: the joint.
        model: how the servo counts.
        least: its own least position.
        most: its own greatest position.
        state: the numbers of the last round.
        errors: the errors of the last answer.
    """

    joint: Protocol1Joint
    model: ServoModel = _AX
    least: int = 0
    most: int = 1023
    state: tuple[int, ...] = (0,) * 9
    errors: int = 0

    @property
    def measured(self) -> int:
        """Return the servo's position."""
        return self.state[4]

    @property
    def has_torque(self) -> bool:
        """Return whether the servo says that its torque is on."""
        return self.state[0] != 0

    def steps(self, position_rad: float) -> int:
        """Return the servo's position for one of the joint, within the servo's own limits."""
        steps = self._zero + self._sign * position_rad / self.model.rad_per_step
        return max(self.least, min(self.most, round(steps)))

    def speed(self) -> int:
        """Return the joint's speed in the servo's unit; 0 would be as fast as it can."""
        return max(1, min(MAX_SPEED, round(self.joint.speed_rad_per_s / self.model.rad_per_s)))

    def position_rad(self) -> float:
        """Return the joint's position."""
        return (self.measured - self._zero) * self.model.rad_per_step * self._sign

    def speed_rad_per_s(self) -> float:
        """Return the joint's speed."""
        speed = self.state[5]
        value = (speed & SPEED_BITS) * self.model.rad_per_s * self._sign
        return -value if speed & BACKWARDS else value

    def problems(self, should_have_torque: bool) -> list[str]:
        """Return what the servo reports, in plain words."""
        texts = [text for bit, text in PROBLEMS.items() if self.errors & bit]
        if should_have_torque and not self.has_torque:
            texts.append("has switched its torque off")
        return [f"{self.joint.name}: {text}" for text in texts]

    @property
    def _zero(self) -> float:
        zero = self.joint.zero_step
        return (self.model.steps - 1) / 2 if zero is None else zero

    @property
    def _sign(self) -> int:
        return -1 if self.joint.is_reversed else 1


class Protocol1Joints(PluggableDevice[JointReading], Joints):
    """Joints on servos with protocol 1.0. `poll` returns their states, at `rate_hz` at most.

    The protocol has no common reading: in each round the driver asks one servo after the other, and `poll`
    takes as long. Commands go to all servos at once. Nothing acknowledges them, so each round also tells
    whether the torque is as it should be.

    When a command expires, the driver switches the torque off. These servos have no watchdog: if this
    process dies or hangs, a guard, which is a process besides, switches their torque off after `watchdog_s`.
    When the guard is lost, the joints hold where they are, and follow no command until a new guard answers.
    If the cable is pulled, they finish their motion and hold their position, until the driver is back and
    switches the torque off.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        servos: the joints.
        bit_rate: bit/s of the line.
        rate_hz: readings each second.
        watchdog_s: the guard switches the torque off when this process is silent for this time.
        options: see `DeviceOptions`.

    Example:
        with closing(Protocol1Joints("/dev/ttyUSB0", [Protocol1Joint("gripper", servo=1)])) as gripper:
            gripper.poll(1.0)
            gripper.command({"gripper": 0.3}, valid_for_s=0.5)
    """

    SILENCE_S = 0.5

    def __init__(
        self,
        url: str,
        servos: Sequence[Protocol1Joint],
        bit_rate: int = BIT_RATE,
        *,
        rate_hz: float = 50.0,
        watchdog_s: float = 0.2,
        **options: Unpack[DeviceOptions],
    ) -> None:
        numbers = [joint.servo for joint in servos]
        if not numbers or len(set(numbers)) < len(numbers) or not all(0 <= one <= 253 for one in numbers):
            raise ValueError(f"each joint needs a servo with a number of 0 to 253, not {numbers}")
        if not watchdog_s > 0:
            raise ValueError(f"watchdog_s must be more than 0, not {watchdog_s:g}")
        super().__init__(url, bit_rate, **options)
        self.expired_commands = 0
        """How many commands have ended because no newer one came in time."""
        self.ignored_commands = 0
        """How many commands came while it was disconnected or its guard was lost."""
        self.guards_replaced = 0
        """How many guards were lost, and replaced."""
        self.missed_rounds = 0
        """How many rounds have ended without a reading, because a servo did not answer."""
        self.repeated_releases = 0
        """How often servos still had torque after it was switched off."""
        self._servos = tuple(_Servo(joint) for joint in servos)
        self._numbers, self._watchdog_s = numbers, watchdog_s
        self._period_s = 1.0 / rate_hz
        self._decoder = FrameDecoder(Protocol1Framing())
        self._next_s = -math.inf
        self._readings: list[JointReading] = []
        self._valid_until_s: float | None = None
        self._has_torque = False
        self._guard: StopGuards | None = None
        self._guard_problem = ""

    @property
    def joints(self) -> Sequence[Protocol1Joint]:
        """Return the joints."""
        return [servo.joint for servo in self._servos]

    @property
    def has_torque(self) -> bool:
        """Return whether the servos' torque is on."""
        return self._has_torque

    @property
    def is_guarded(self) -> bool:
        """Return whether a guard would let the joints go if this process died; `rfc2217://` has none."""
        return self._guard is not None and self._guard.is_answering

    def command(self, positions_rad: Mapping[str, float], valid_for_s: float) -> None:
        """Move joints to positions; without a connection, or without its guard, nothing happens."""
        goals = checked(self.joints, positions_rad, valid_for_s)
        until_s = self._monotonic() + capped_validity_s(valid_for_s)
        if not goals:
            return
        if not self.is_connected or not self._allow(self._watchdog_s):
            self.ignored_commands += 1
            return
        wanted = {self._numbers[place]: self._servos[place].steps(goal) for place, goal in goals.items()}
        self._valid_until_s = until_s
        # This process may have been stopped meanwhile, or be stopped in the middle of the write.
        if self._release_expired():
            return
        if self._has_torque:
            self._write_goals(wanted)
        else:
            # A servo whose torque comes on goes to its old goal: each of them gets a new one first.
            self._has_torque = True
            self._write_goals(self._measured_steps() | wanted)
            self._write_torque(True)
        self._release_expired()

    def release(self) -> None:
        """Switch the torque of all servos off."""
        self._valid_until_s, self._has_torque = None, False
        self._write_torque(False)
        self._allow(0.0)

    def poll(self, wait_s: float = 0.0) -> list[JointReading]:
        """Return the states since the last call; let the joints go when a command has expired."""
        end_s = self._monotonic() + wait_s
        self._watch_guard()
        if self.is_connected and self._monotonic() >= self._next_s:
            self._next_s = max(self._next_s + self._period_s, self._monotonic())
            self._go_round()
        due_s = end_s
        if self._guard is not None:
            due_s = min(due_s, self._monotonic() + PING_PERIOD_S)
        if self.is_connected:
            due_s = min(due_s, self._next_s if not self._readings else -math.inf)
        if self._valid_until_s is not None:
            due_s = min(due_s, self._valid_until_s)
        readings = super().poll(max(0.0, due_s - self._monotonic()))
        self._release_expired()
        return readings

    def _release_expired(self) -> bool:
        """Let the joints go if their command has expired. Return whether it has."""
        has_expired = self._valid_until_s is not None and self._monotonic() >= self._valid_until_s
        if has_expired:
            self.expired_commands += 1
            self.release()
        return has_expired

    def _go_round(self) -> None:
        """Ask each servo, and make a reading of the answers."""
        try:
            for servo in self._servos:
                self._read_state(self.port, servo)
        except DeviceSilent as error:
            self.missed_rounds += 1
            if self._monotonic() - self._valid_s > self.silence_s:
                self._lose(error)
            return
        except OSError as error:
            self._lose(error)
            return
        problems = [text for servo in self._servos for text in servo.problems(self._has_torque)]
        if self._guard_problem:
            problems.append(self._guard_problem)
            self._guard_problem = "" if self.is_guarded else self._guard_problem
        if not self._has_torque and any(servo.has_torque for servo in self._servos):
            self.repeated_releases += 1
            self._write_torque(False)
        self._readings.append(
            JointReading(
                self._clock(),
                tuple(servo.position_rad() for servo in self._servos),
                tuple(servo.speed_rad_per_s() for servo in self._servos),
                tuple(problems),
            )
        )

    def _start(self, port: Port) -> None:
        """Ask for each servo, switch its torque off and set its speed."""
        port.drain(quiet_s=0.01, limit_s=0.1)
        for servo in self._servos:
            self._identify(port, servo)
        speeds = {
            servo.joint.servo: max(
                1, min(MAX_SPEED, round(servo.joint.speed_rad_per_s / servo.model.rad_per_s))
            )
            for servo in self._servos
        }
        for _ in range(ATTEMPTS):
            port.write(self._torque(False))
            port.write(protocol1.sync_write(MOVING_SPEED, _words(speeds)))
            for servo in self._servos:
                self._read_state(port, servo)
            if not any(one.has_torque or one.state[2] != speeds[one.joint.servo] for one in self._servos):
                break
        else:
            raise DeviceFault(f"servos at {self.url} do not take their settings")
        if port.descriptor is not None:
            self._guard = StopGuards(port.descriptor, self._torque(False))

    def _identify(self, port: Port, servo: _Servo) -> None:
        number = servo.joint.servo
        told = self._ask(port, number, MODEL, _IDENTITY.size).parameters
        model, _, _, _, _, least, most = _IDENTITY.unpack(told)
        if model not in MODELS:
            raise DeviceFault(
                f"servo {number} at {self.url} is of model {model}, which this driver does not know"
            )
        if least == most:
            raise DeviceFault(
                f"servo {number} at {self.url} turns without end (limits {least} and {most}): give it limits"
            )
        servo.model, servo.least, servo.most = MODELS[model], least, most

    def _read_state(self, port: Port, servo: _Servo) -> None:
        answer = self._ask(port, servo.joint.servo, TORQUE_ENABLE, _STATE.size)
        servo.state, servo.errors = _STATE.unpack(answer.parameters), answer.code

    def _ask(self, port: Port, servo: int, address: int, length: int) -> Packet1:
        """Read from a servo's table."""
        for _ in range(ATTEMPTS):
            self._decoder.feed(port.read(0.0))  # an answer that came too late is no answer to this
            port.write(protocol1.read(servo, address, length))
            end_s = monotonic() + ANSWER_S
            while (left_s := end_s - monotonic()) > 0:
                for packet in self._decoder.feed(port.read(left_s)):
                    # A line of two wires repeats what we send; a question is shorter than its answer.
                    if packet.servo == servo and len(packet.parameters) == length:
                        return packet
        raise DeviceSilent(f"servo {servo} at {self.url} does not answer at {self.bit_rate} bit/s")

    def _take(self, data: bytes) -> list[JointReading]:
        self._decoder.feed(data)
        self.counters.damaged = self._decoder.damaged
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        readings, self._readings = self._readings, []
        return readings

    def _write_goals(self, steps: Mapping[int, int]) -> None:
        self.send(protocol1.sync_write(GOAL_POSITION, _words(steps)))

    def _write_torque(self, is_on: bool) -> None:
        self.send(self._torque(is_on))

    def _torque(self, is_on: bool) -> bytes:
        return protocol1.sync_write(TORQUE_ENABLE, dict.fromkeys(self._numbers, bytes([is_on])))

    def _allow(self, valid_for_s: float) -> bool:
        """Tell the guard how long the joints may be held without another word. Return whether they may."""
        return self._guard is None or self._guard.allow(valid_for_s)

    def _watch_guard(self) -> None:
        """Say that this process lives. Hold the joints where they are when the guard is lost."""
        if self._guard is not None and (lost := self._guard.watch()):
            self.guards_replaced += 1
            self._guard_problem = lost
            if self._has_torque:
                self._write_goals(self._measured_steps())
            # The other guard must not let go what is held now.
            self._allow(0.0)
        else:
            self._allow(self._watchdog_s if self._has_torque else 0.0)

    def _measured_steps(self) -> dict[int, int]:
        return {servo.joint.servo: servo.measured for servo in self._servos}

    def _reset(self) -> None:
        self._decoder.reset()
        self._readings.clear()
        self._valid_until_s, self._has_torque = None, False
        self._next_s = -math.inf
        self._guard_problem = ""
        if self._guard is not None:
            self._guard.close()
            self._guard = None

    def _stop(self) -> None:
        self.release()


def _words(values: Mapping[int, int]) -> dict[int, bytes]:
    return {servo: struct.pack("<H", value) for servo, value in values.items()}
