"""Base of the modules of all bases: the one commander of the drive, and the emergency stop."""

import math
from collections import Counter
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp import CallRefused, Header, MessageHandling, Module, Time, setting
from robbie_mp.messages import (
    BatteryState,
    ControlSet,
    ControlState,
    DriveCommand,
    EmergencyStop,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    SetControl,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from robbie_robots.hw.drive import Drive, DriveCommandError, DriveState
from robbie_robots.modules.devices.command_age import (
    MAX_AGE_S,
    ORDER_WITHIN_S,
    StaleCommand,
    check_order,
    command_since,
    left_s,
    waiting_s,
)
from robbie_robots.modules.devices.hand_guard import HandGuard
from robbie_robots.workers.driving.control import MAX_REASON, ControlMode, DriveControl

MANUAL_TOPIC = "manual"
CONTROL_TOPIC = "control"
# Rows of a pose's covariance that a robot in the plane has: x, y and yaw.
PLANE = (0, 1, 5)


LOST = "nobody knows what was kept before a restart: the newest checkpoint was damaged or is gone"
WARN_PERIOD_S = 5.0
"""Of refused commands, no more is logged than one in this time."""


class CommandedBase(Module):
    """A module whose drive follows `DriveCommand` and `EmergencyStop`, and stops on an empty battery.

    It owns the state of who controls the robot, and publishes it as `ControlState` on topic `control`:
    commands on topic `manual` take over; other commands are followed only in AUTO, and only those of one
    module: it keeps control until it is silent for `let_go_s`. After an emergency stop, and when an operator
    has let go, the robot holds until an operator drives or `SetControl` orders AUTO.

    A command is followed until it expires, or until what it rests on is older than `max_age_s`. Where
    `guard_topics` names lasers, commands by hand are slowed as what these see requires.

    Where the newest checkpoint was damaged or is gone, the base starts with the emergency stop engaged.

    A subclass creates `drive` in `setup`, calls `obey` there, and calls `look_after_control` in `tick`.
    `confirm` publishes `EmergencyStop` on `emergency_stop_state`.
    """

    drive: Drive
    stop_reason: str

    max_age_s: float = MAX_AGE_S
    let_go_s: float = setting(
        0.5,
        "an operator, or a module that drives, has let go when it has sent no command for this time",
        minimum=0.1,
    )
    starts_in_auto: bool = setting(True, "false: the robot holds at the start until it is ordered to go on")
    guard_topics: list[str] = setting(
        [], "topics of the lasers that guard driving by hand; a robot without any drives unguarded"
    )
    guard_radius_m: float = setting(0.2, "radius of the robot's body, for driving by hand", minimum=0.05)

    def obey(self) -> None:
        """Subscribe to what commands the drive."""
        before = None if self.restored is None else self.restored["control"]
        mode = ControlMode.AUTO if self.starts_in_auto else ControlMode.HOLD
        self.control = DriveControl(self.monotonic_s, mode, self.let_go_s, before)
        if before is not None and self.incarnation == 1 and not self.starts_in_auto:
            self.control.order(ControlMode.HOLD, self.name, "the run has started", self.monotonic_s())
        if self.checkpoint_lost:
            self._stop_for_lost_state()
        self.told_control: dict[str, Any] | None = None
        self.refused: Counter[str] = Counter()
        self.warned_s = -math.inf
        self.guard = HandGuard(self, self.guard_topics, self.guard_radius_m, self.max_age_s)
        self.subscribe(DriveCommand, self.on_command, optional=True)
        self.subscribe(EmergencyStop, self.on_emergency_stop, topic="emergency_stop", optional=True)
        self.subscribe(
            BatteryState, self.on_battery, MessageHandling.KEEP_ONLY_NEWEST, topic="battery", optional=True
        )
        self.advertise(ControlState, topic=CONTROL_TOPIC)
        self.serve(SetControl, self.on_set_control)

    def _stop_for_lost_state(self) -> None:
        """Engage the emergency stop: an older state may not know of one, nor that the robot held."""
        self.stop_reason = LOST
        self.drive.stop_for_emergency()
        self.control.see_stop(True, self.name, LOST)

    def on_command(self, command: DriveCommand) -> None:
        """Follow the command if its sender is in control, while it and what it rests on are fresh."""
        by_hand = self.envelope.topic == MANUAL_TOPIC
        moves = bool(command.linear_m_per_s or command.angular_rad_per_s)
        sent_s = self.envelope.published_ns / 1e9
        refuses = self.control.refuses_by_hand if by_hand else self.control.refuses_module
        refusal = refuses(self.envelope.sender, moves, sent_s)
        # Before the robot moves: if that kills this process, the next one must know who had taken over.
        self.tell_control()
        if refusal:
            # Modules go on sending while the robot holds; that two send at once is a mistake.
            is_loud = by_hand or self.control.mode is ControlMode.AUTO
            self._refuse("not in control", refusal, is_loud=is_loud)
        elif not moves:
            self.drive.stop()
        else:
            self._follow(command, is_guarded=by_hand and not command.unguarded)

    def _follow(self, command: DriveCommand, *, is_guarded: bool) -> None:
        wanted = command.linear_m_per_s, command.angular_rad_per_s
        judged_s = self.monotonic_s()
        try:
            valid_for_s = left_s(self, command, self.max_age_s)
            if is_guarded:
                valid_for_s = min(valid_for_s, self.guard.sees_for_s)
                if valid_for_s <= 0.0:
                    raise StaleCommand("a laser that guards driving by hand has sent no scan lately")
                wanted = self.guard.checked(*wanted)
            drive = partial(self.drive.command, *wanted)
            command_since(self, judged_s, valid_for_s, drive, self.drive.stop)
        except StaleCommand as error:
            self._refuse("too old", str(error))
        except DriveCommandError as error:
            self.drive.stop()
            self._refuse("invalid", str(error))

    def _refuse(self, kind: str, reason: str, *, is_loud: bool = True) -> None:
        """Count a command that is not followed, and log some of them."""
        self.refused[kind] += 1
        now_s = self.monotonic_s()
        if is_loud and now_s - self.warned_s >= WARN_PERIOD_S:
            self.warned_s = now_s
            self.log.warning("refused a drive command of %s: %s", self.envelope.sender, reason)

    def on_set_control(self, request: SetControl) -> ControlSet:
        """Go on, or hold, as ordered."""
        if request.mode not in list(ControlMode):
            raise CallRefused(f"there is no mode {request.mode}; 0 is AUTO and 2 is HOLD")
        if request.mode == ControlMode.AUTO:
            check_order(self)
        sent_s = self.envelope.published_ns / 1e9
        refusal = self.control.order(ControlMode(request.mode), self.envelope.sender, request.reason, sent_s)
        if refusal:
            raise CallRefused(refusal)
        if self.control.mode is ControlMode.HOLD:
            self.drive.stop()
        self.tell_control()
        return ControlSet(mode=int(self.control.mode))

    def look_after_control(self) -> None:
        """Hold the robot when its operator has let go, and say who controls it."""
        self.control.look_after()
        self.tell_control()

    def tell_control(self) -> None:
        """Publish who controls the robot, if that is new; first of all so that it survives a restart."""
        memory = self.control.memory()
        if memory == self.told_control:
            return
        told, self.told_control = self.told_control, memory
        self.confirm()
        if told is not None and told | {"driver": ""} == memory | {"driver": ""}:
            return
        self.log.info("%s: %s", self.control.mode.name, self.control.reason)
        self.publish(
            ControlState(
                header=Header(stamp=self.now(), frame_id="base_link"),
                mode=int(self.control.mode),
                who=self.control.who,
                reason=self.control.reason,
            ),
            topic=CONTROL_TOPIC,
        )

    @property
    def control_status(self) -> str:
        """Return who controls the robot, and how many commands were refused, to begin a status line."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.refused.items())
        return f"{self.control.mode.name}{f' (refused commands: {kinds})' if kinds else ''}, "

    def on_emergency_stop(self, request: EmergencyStop) -> None:
        """Engage the emergency stop, or release it; a late release does nothing."""
        if not request.engaged and waiting_s(self) > ORDER_WITHIN_S:
            self.log.warning("refused a late release of the emergency stop by %s", self.envelope.sender)
            self.confirm()
            return
        self.stop_reason = request.reason[:MAX_REASON] if request.engaged else ""
        self.control.see_stop(request.engaged, self.envelope.sender, request.reason)
        if request.engaged:
            self.drive.stop_for_emergency()
            self.log.warning("emergency stop by %s: %s", self.envelope.sender, request.reason)
        else:
            self.drive.release()
            self.log.info("emergency stop released by %s: %s", self.envelope.sender, request.reason)
        self.confirm()
        self.tell_control()

    def on_battery(self, battery: BatteryState) -> None:
        """Engage the emergency stop when the battery is empty."""
        if battery.percentage <= 0 and not self.drive.is_emergency_stopped:
            self.stop_reason = "the battery is empty"
            self.control.see_stop(True, self.name, self.stop_reason)
            self.drive.stop_for_emergency()
            self.log.error("the battery is empty: emergency stop")

    def confirm(self) -> None:
        """Publish the emergency stop's state."""
        stamp = self.now()
        state = EmergencyStop(
            header=Header(stamp=stamp, frame_id="base_link"),
            engaged=self.drive.is_emergency_stopped,
            reason=self.stop_reason,
        )
        self.publish(state, topic="emergency_stop_state")


def odometry(
    state: DriveState, stamp: Time, frame: str, covariance: NDArray[np.float64] | None = None
) -> Odometry:
    """Return the odometry message for a drive state.

    Args:
        state: the drive state.
        stamp: its time.
        frame: the frame of its pose.
        covariance: (3, 3), of the pose's x, y and heading; None: unknown.
    """
    # ROS has x, y, z and the three rotations: x, y and yaw are 0, 1 and 5.
    spread = np.zeros((6, 6))
    if covariance is not None:
        spread[np.ix_(PLANE, PLANE)] = covariance
    pose = Pose(
        position=Point(x=state.pose.x_m, y=state.pose.y_m),
        orientation=Quaternion.from_yaw(state.pose.heading_rad),
    )
    twist = Twist(linear=Vector3(x=state.linear_m_per_s), angular=Vector3(z=state.angular_rad_per_s))
    return Odometry(
        header=Header(stamp=stamp, frame_id=frame),
        child_frame_id="base_link",
        pose=PoseWithCovariance(pose=pose, covariance=spread.ravel()),
        twist=TwistWithCovariance(twist=twist),
    )
