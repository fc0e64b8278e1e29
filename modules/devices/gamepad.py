"""The operator's gamepad."""

from robbie_mp import REQUIRED, Duration, Header, Module, Time, setting
from robbie_mp.messages import DeviceState, DriveCommand, Mark
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_robots.hw.gamepad import Gamepad

STATE_PERIOD_S = 1.0
STOOD_STILL_S = 0.5
"""Time between two ticks after which the operator must take hold again: the robot has stopped meanwhile."""
# Codes of Linux: BTN_TL, BTN_SELECT, ABS_X and ABS_Y.
LEFT_SHOULDER = 0x136
SELECT = 0x13A
ABS_X, ABS_Y = 0, 1


class GamepadModule(Module):
    """Drives the robot by a stick, only while the operator holds the dead-man button.

    When the operator lets go, or the gamepad is pulled out, the robot is stopped once and commanded no
    more. Even if this module dies, its last command expires, and when it has stood still, the operator must
    take hold again. A stick that was not moved since the gamepad
    was plugged in counts as centred.

    Publishes `DriveCommand` on topic `manual`, `DeviceState` on a topic named after the module, and a `Mark`
    when the operator presses the button that marks the moment.
    """

    device: str = setting(REQUIRED, "file of the gamepad, such as /dev/input/by-id/usb-…-event-joystick")
    dead_man_button: int = setting(LEFT_SHOULDER, "code of the button that must be held", minimum=0)
    mark_button: int = setting(SELECT, "code of the button that marks the moment", minimum=0)
    forward_axis: int = setting(ABS_Y, "code of the axis for forward", minimum=0)
    turn_axis: int = setting(ABS_X, "code of the axis for turning", minimum=0)
    axis_min: int = setting(-32768, "an axis' value when pushed forward or left")
    axis_max: int = setting(32767, "an axis' value when pushed back or right")
    dead_zone: float = setting(
        0.1, "less than this share of the way counts as centred", minimum=0.0, maximum=0.9
    )
    max_linear_m_per_s: float = setting(0.5, "speed at a stick pushed fully forward", minimum=0.0)
    max_angular_rad_per_s: float = setting(1.0, "turn rate at a stick pushed fully aside", minimum=0.0)
    valid_for_s: float = setting(
        0.25, "a command expires after this time", minimum=0.05, maximum=MAX_VALID_FOR_S
    )
    period_s: float = setting(0.05, "time between commands", minimum=0.005)

    def setup(self) -> None:
        """Look for the gamepad in the first tick, and ever after."""
        self.gamepad = Gamepad(self.device)
        self.is_driving = False
        self.is_marking = False
        self.marks = 0
        self.told: bool | None = None
        self.told_ns = 0
        self.polled_ns = self.clock.monotonic_ns()

    def tick(self) -> None:
        """Publish the command that the operator gives."""
        self.gamepad.poll()
        before_ns, self.polled_ns = self.polled_ns, self.clock.monotonic_ns()
        if self.polled_ns - before_ns > STOOD_STILL_S * 1e9:
            self.gamepad.forget()
        if self.dead_man_button in self.gamepad.state.pressed:
            # Forward and left are an axis' lowest values.
            linear = -self._pushed(self.forward_axis) * self.max_linear_m_per_s
            angular = -self._pushed(self.turn_axis) * self.max_angular_rad_per_s
            self._command(linear, angular)
            self.is_driving = True
            self.status = f"{linear:.2f} m/s, {angular:.2f} rad/s"
        elif self.is_driving:
            self._command(0.0, 0.0)
            self.is_driving = False
        self._mark()
        self._tell_state()

    def teardown(self) -> None:
        """Stop the robot if the operator is driving it."""
        if self.is_driving:
            self._command(0.0, 0.0)
        self.gamepad.close()

    def _pushed(self, axis: int) -> float:
        """Return how far a stick is pushed, -1 to 1."""
        half = (self.axis_max - self.axis_min) / 2
        value = self.gamepad.state.axes.get(axis)
        share = 0.0 if value is None else (value - self.axis_min) / half - 1
        share = max(-1.0, min(1.0, share))
        if abs(share) < self.dead_zone:
            return 0.0
        return (share - (self.dead_zone if share > 0 else -self.dead_zone)) / (1 - self.dead_zone)

    def _command(self, linear_m_per_s: float, angular_rad_per_s: float) -> None:
        now = self.now()
        self.publish(
            DriveCommand(
                header=Header(stamp=now),
                linear_m_per_s=linear_m_per_s,
                angular_rad_per_s=angular_rad_per_s,
                valid_for=Duration.from_seconds(self.valid_for_s),
                based_on=now,
            ),
            topic="manual",
        )

    def _mark(self) -> None:
        """Mark the moment in which the button goes down."""
        was_marking, self.is_marking = self.is_marking, self.mark_button in self.gamepad.state.pressed
        if self.is_marking and not was_marking:
            self.marks += 1
            self.publish(Mark(header=Header(stamp=self.now()), text=f"gamepad {self.marks}"))

    def _tell_state(self) -> None:
        """Publish whether the gamepad is there, when that changes and every second."""
        now_ns, gamepad = self.clock.now_ns(), self.gamepad
        if gamepad.is_connected is self.told and now_ns - self.told_ns < STATE_PERIOD_S * 1e9:
            return
        self.told, self.told_ns = gamepad.is_connected, now_ns
        self.publish(
            DeviceState(
                header=Header(stamp=Time.from_nanoseconds(now_ns)),
                port=self.device,
                state="CONNECTED" if gamepad.is_connected else "DISCONNECTED",
                reason=gamepad.reason,
                connections=gamepad.connections,
                losses=gamepad.losses,
            ),
            topic=self.name,
        )
        self.degraded = "" if gamepad.is_connected else f"the gamepad is disconnected: {gamepad.reason}"
        if not gamepad.is_connected:
            self.status = f"DISCONNECTED: {gamepad.reason}"
        elif not self.is_driving:
            self.status = "the dead-man button is not held"
