"""Joints that follow commands: grippers, pan-tilt units and arms."""

import math
from functools import partial
from typing import Any

import numpy as np

from robbie_mp import REQUIRED, CallError, Header, Module, SettingError, Time, setting
from robbie_mp.messages import (
    ControlSet,
    ControlState,
    JointCommand,
    JointLimits,
    JointState,
    PanTiltCommand,
    SetControl,
)
from robbie_robots.hw.dynamixel.protocol1_joints import Protocol1Joint, Protocol1Joints
from robbie_robots.hw.dynamixel.servos import BIT_RATE, STEPS_PER_TURN, DynamixelJoints, ServoJoint
from robbie_robots.hw.joints import Joint, JointCommandError, JointReading, Joints, checked
from robbie_robots.hw.simulation.joints import SimulatedJoints
from robbie_robots.modules.devices.command_age import MAX_AGE_S, StaleCommand, command_since, left_s
from robbie_robots.modules.devices.joint_control import JointControl, JointSource
from robbie_robots.modules.devices.joint_orders import JointOrders
from robbie_robots.modules.devices.pluggable import PluggableDeviceModule

PAN_TILT = ["pan", "tilt"]


class CommandedJoints(Module):
    """A module whose joints follow `JointCommand` and, if they are `pan` and `tilt`, `PanTiltCommand`.

    When a `JointCommand` expires, the joints are let go. After a `PanTiltCommand` the unit holds its
    direction.

    One sender at a time moves the joints, until it is silent for 0.5 s. A command by hand (`by_hand`) takes
    over, and then the robot holds: the module orders it from the base.

    While the base tells that the emergency stop is engaged, joints stay where they are, as long as commands
    come; so they do at commands of modules while the base does not tell AUTO. After it, a control that was
    held must be let go first, or commands must begin where the joints were stopped. The direction of a
    `PanTiltCommand` is kept until it expires. A pan-tilt unit only turns a camera: the robot does not hold
    because an operator moves it.

    Publishes `JointState` on a topic named after the module, and follows `JointCommand` on the same topic.
    There it also publishes `JointLimits`, which is latched.
    """

    moved: Joints

    names: list[str] = setting(REQUIRED, "names of the joints")
    least_rad: list[float] = setting([], "least position of each joint; default -pi")
    most_rad: list[float] = setting([], "greatest position of each joint; default pi")
    speed_rad_per_s: float = setting(1.0, "speed of each joint", minimum=0.01)
    max_age_s: float = MAX_AGE_S

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Raise SettingError if the lists do not fit."""
        names = settings["names"]
        assert isinstance(names, list)
        if not names or len(set(names)) < len(names):
            raise SettingError("expected at least one joint, each with a name that no other has", "names")
        for name in ("least_rad", "most_rad", "servos", "zero_steps", "reversed"):
            values = settings.get(name)
            if isinstance(values, list) and len(values) not in (0, len(names)):
                raise SettingError(f"expected a value for each of the {len(names)} joints, or none", name)
        super().check(settings)

    def obey(self) -> None:
        """Subscribe to the commands, and publish which joints there are."""
        ends = [self.limits(place) for place in range(len(self.names))]
        self.publish(
            JointLimits(
                name=self.names,
                lower=np.array([one["least_rad"] for one in ends]),
                upper=np.array([one["most_rad"] for one in ends]),
            ),
            topic=self.name,
            latched=True,
        )
        self.control = JointControl(self.monotonic_s)
        self.orders = JointOrders(self, self.control, self._keep_joints)
        self.asks_to_hold = False
        self.refused = 0
        self.subscribe(JointCommand, self.on_joint_command, topic=self.name, optional=True)
        if self._is_pan_tilt:
            self.subscribe(PanTiltCommand, self.on_pan_tilt, optional=True)

    def on_joint_command(self, command: JointCommand) -> None:
        """Move the joints while the command is valid, and what it rests on is fresh."""
        if len(command.name) != len(command.position):
            self.log.error(
                "ignored a command from %s with %d names and %d positions",
                self.envelope.sender,
                len(command.name),
                len(command.position),
            )
            return
        self._move(dict(zip(command.name, command.position.tolist(), strict=True)), command)

    def _keep_joints(self) -> None:
        """Stop the joints where they are, as long as the last command is valid."""
        left_s = self.control.until_s - self.monotonic_s()
        if left_s > 0.0:
            self.moved.command(self.control.kept, left_s)

    def on_pan_tilt(self, command: PanTiltCommand) -> None:
        """Look in a direction, as soon as modules may move the unit."""
        try:
            until_s = self.monotonic_s() + left_s(self, command, self.max_age_s)
        except StaleCommand as error:
            self._log_invalid(error)
            return
        self.control.direct({"pan": command.pan_rad, "tilt": command.tilt_rad}, until_s)
        self._look()

    def _look(self) -> None:
        if goals := self.control.due_direction():
            self.moved.command(goals, math.inf)

    def publish_state(self, reading: JointReading) -> None:
        """Publish where the joints are."""
        self.see_joints(reading)
        self.checkpoint({"orders": self.orders.memory})
        self.publish(
            JointState(
                header=Header(stamp=Time.from_nanoseconds(round(reading.stamp_s * 1e9))),
                name=self.names,
                position=np.array(reading.positions_rad),
                velocity=np.array(reading.speeds_rad_per_s),
            ),
            topic=self.name,
        )

    def see_joints(self, reading: JointReading) -> None:
        """Know where the joints are when an emergency stop comes; look where modules want."""
        rows = zip(self.names, reading.positions_rad, reading.speeds_rad_per_s, strict=True)
        self.control.see({name: (at, speed) for name, at, speed in rows if math.isfinite(at)})
        self._look()

    def limits(self, place: int) -> dict[str, float]:
        """Return the limits of one joint, as arguments of `Joint`."""
        return {
            "least_rad": self.least_rad[place] if self.least_rad else -math.pi,
            "most_rad": self.most_rad[place] if self.most_rad else math.pi,
            "speed_rad_per_s": self.speed_rad_per_s,
        }

    def figures(self, expired: int) -> str:
        """Return how many commands have expired or were refused, for a status line."""
        refused = f", {self.refused} refused commands" if self.refused else ""
        return f"{expired} expired commands{refused}"

    def _move(self, positions_rad: dict[str, float], command: JointCommand) -> None:
        judged_s = self.monotonic_s()
        try:
            fresh_s = left_s(self, command, self.max_age_s)
            checked(self.moved.joints, positions_rad, fresh_s)
            source = JointSource(self.envelope.sender, command.by_hand)
            sent_s, until_s = self.envelope.published_ns / 1e9, judged_s + fresh_s
            followed = self.control.followed(source, positions_rad, sent_s, until_s)
            if followed is None:
                self._refuse()
                return
            move = partial(self.moved.command, followed)
            command_since(self, judged_s, fresh_s, move, self.moved.release)
            if command.by_hand and self.orders.mode == ControlState.AUTO and not self._is_pan_tilt:
                self._ask_to_hold()
        except (JointCommandError, StaleCommand) as error:
            self._log_invalid(error)

    def _log_invalid(self, error: ValueError) -> None:
        self.log.error("ignored an invalid command from %s: %s", self.envelope.sender, error)

    @property
    def _is_pan_tilt(self) -> bool:
        return sorted(self.names) == PAN_TILT

    def _refuse(self) -> None:
        """Count a command of a sender while another one moves the joints."""
        self.refused += 1
        if self.refused.bit_count() == 1:  # the 1st, 2nd, 4th, 8th …
            mover, sender = self.control.mover, self.envelope.sender
            text = "refused a command of %s: %s moves the joints (%d refused)"
            self.log.warning(text, sender, mover, self.refused)

    def _ask_to_hold(self) -> None:
        """Let the robot hold, because an operator has taken over its joints."""
        if self.asks_to_hold:
            return
        self.asks_to_hold = True
        reason = f"{self.envelope.sender} moves {self.name} by hand"
        self.call(SetControl(mode=ControlState.HOLD, reason=reason), self._asked, self._asked)

    def _asked(self, _answer: ControlSet | CallError) -> None:
        self.asks_to_hold = False


class SimulatedJointsModule(CommandedJoints):
    """Simulated joints: see `CommandedJoints`."""

    period_s: float = setting(0.02, "time between messages", minimum=0.005)

    def setup(self) -> None:
        """Create the joints."""
        joints = [Joint(name, **self.limits(place)) for place, name in enumerate(self.names)]
        self.simulated = SimulatedJoints(joints, self.monotonic_s)
        self.moved = self.simulated
        self.obey()

    def tick(self) -> None:
        """Publish where the joints are."""
        reading = self.simulated.read()
        now_s = self.clock.now_ns() / 1e9
        self.publish_state(JointReading(now_s, reading.positions_rad, reading.speeds_rad_per_s))
        self.status = f"{len(self.names)} joints, {self.figures(self.simulated.expired_commands)}"


class DynamixelModule(CommandedJoints, PluggableDeviceModule[JointReading]):
    """Joints on Dynamixel servos: see `CommandedJoints`. Publishes `DeviceState`, too."""

    # Its time is the machine's: commands of a log that is played rest on what was long ago.
    follows_run_clock = False
    wait_s = 0.0

    protocol: int = setting(2, "the servos' protocol: 1 for AX, RX, EX and older MX", choices=(1, 2))
    bit_rate: int = setting(BIT_RATE, "bit/s of the servos' line", minimum=9600)
    servos: list[int] = setting([], "number of each joint's servo; default 1, 2, 3 and so on")
    zero_steps: list[int] = setting([], "servo position where each joint is at 0; default: the middle")
    reversed: list[bool] = setting([], "whether each joint turns against its servo")
    rate_hz: float = setting(50.0, "readings each second", minimum=1.0, maximum=500.0)
    watchdog_s: float = setting(
        0.2,
        "the servos stop, or are let go, when the driver is silent for this time",
        minimum=0.02,
        maximum=2.54,
    )

    def setup(self) -> None:
        """Create the driver."""
        super().setup()
        assert isinstance(self.device, DynamixelJoints | Protocol1Joints)
        self.moved = self.driver = self.device
        self.problems: tuple[str, ...] = ()
        self.obey()

    def open_device(self) -> DynamixelJoints | Protocol1Joints:
        """Return the driver."""
        if self.protocol == 1:
            return Protocol1Joints(
                self.url,
                [
                    Protocol1Joint(
                        **self.mounting(place), zero_step=self.zero_steps[place] if self.zero_steps else None
                    )
                    for place in range(len(self.names))
                ],
                self.bit_rate,
                rate_hz=self.rate_hz,
                watchdog_s=self.watchdog_s,
                clock=self.time_s,
                silence_s=self.silence_s,
            )
        joints = [
            ServoJoint(
                **self.mounting(place),
                zero_step=self.zero_steps[place] if self.zero_steps else STEPS_PER_TURN // 2,
            )
            for place in range(len(self.names))
        ]
        return DynamixelJoints(
            self.url,
            joints,
            self.bit_rate,
            rate_hz=self.rate_hz,
            watchdog_s=self.watchdog_s,
            clock=self.time_s,
            silence_s=self.silence_s,
        )

    def mounting(self, place: int) -> dict[str, Any]:
        """Return what drivers of both protocols need of a joint."""
        return {
            "name": self.names[place],
            **self.limits(place),
            "servo": self.servos[place] if self.servos else place + 1,
            "is_reversed": bool(self.reversed) and self.reversed[place],
        }

    def on_value(self, value: JointReading) -> None:
        """Publish where the joints are."""
        self.publish_state(value)
        self.problems = value.problems

    @property
    def complaint(self) -> str:
        """Return what the servos report, such as that one is too hot."""
        return f"the servos report: {', '.join(self.problems)}" if self.problems else ""

    def status_line(self) -> str:
        """Return the line that `robbie top` shows."""
        if not self.device.is_connected:
            return super().status_line()
        torque = "torque on" if self.driver.has_torque else "torque off"
        figures = self.figures(self.driver.expired_commands)
        return f"{torque}, {super().status_line()}, {figures}"
