"""Base of the modules of all bases: the one commander of the drive, and the emergency stop."""

import math

import numpy as np
from numpy.typing import NDArray

from hw.drive import Drive, DriveCommandError, DriveState
from robbie_mp import Header, MessageHandling, Module, Time, setting
from robbie_mp.messages import (
    BatteryState,
    DriveCommand,
    EmergencyStop,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Twist,
    TwistWithCovariance,
    Vector3,
)

MANUAL_TOPIC = "manual"
# Rows of a pose's covariance that a robot in the plane has: x, y and yaw.
PLANE = (0, 1, 5)


class CommandedBase(Module):
    """A module whose drive follows `DriveCommand` and `EmergencyStop`, and stops on an empty battery.

    A subclass creates `drive` in `setup` and calls `obey`. `confirm` publishes `EmergencyStop` on
    `emergency_stop_state`.
    """

    drive: Drive
    stop_reason: str

    manual_hold_s: float = setting(
        2.0,
        "after a command on topic `manual`, commands from other topics are ignored for this time",
        minimum=0.0,
    )

    def obey(self) -> None:
        """Subscribe to what commands the drive."""
        self.manual_until_s = -math.inf
        self.subscribe(DriveCommand, self.on_command, optional=True)
        self.subscribe(EmergencyStop, self.on_emergency_stop, topic="emergency_stop", optional=True)
        self.subscribe(
            BatteryState, self.on_battery, MessageHandling.KEEP_ONLY_NEWEST, topic="battery", optional=True
        )

    def on_command(self, command: DriveCommand) -> None:
        """Follow the command while it is valid; manual commands take precedence over all others."""
        now_s = self.monotonic_s()
        if self.envelope.topic == MANUAL_TOPIC:
            self.manual_until_s = now_s + self.manual_hold_s
        elif now_s < self.manual_until_s:
            return
        # The age counts from publication: this module may have been stopped while the command waited.
        age_s = max(0.0, now_s - self.envelope.published_ns / 1e9)
        valid_for_s = command.valid_for.nanoseconds / 1e9
        if age_s >= valid_for_s > 0:
            return
        valid_for_s -= age_s
        try:
            self.drive.command(command.linear_m_per_s, command.angular_rad_per_s, valid_for_s)
        except DriveCommandError as error:
            self.drive.stop()
            self.log.error(
                "stopped the robot because a command from %s is invalid: %s", self.envelope.sender, error
            )

    def on_emergency_stop(self, request: EmergencyStop) -> None:
        """Engage the emergency stop, or release it."""
        self.stop_reason = request.reason if request.engaged else ""
        if request.engaged:
            self.drive.stop_for_emergency()
            self.log.warning("emergency stop by %s: %s", self.envelope.sender, request.reason)
        else:
            self.drive.release()
            self.log.info("emergency stop released by %s: %s", self.envelope.sender, request.reason)
        self.confirm()

    def on_battery(self, battery: BatteryState) -> None:
        """Engage the emergency stop when the battery is empty."""
        if battery.percentage <= 0 and not self.drive.is_emergency_stopped:
            self.stop_reason = "the battery is empty"
            self.drive.stop_for_emergency()
            self.log.error("the battery is empty: emergency stop")

    def confirm(self) -> None:
        """Publish the emergency stop's state."""
        stamp = Time.from_nanoseconds(self.clock.now_ns())
        state = EmergencyStop(
            header=Header(stamp=stamp, frame_id="base_link"),
            engaged=self.drive.is_emergency_stopped,
            reason=self.stop_reason,
        )
        self.publish(state, topic="emergency_stop_state")

    def monotonic_s(self) -> float:
        """Return the run's time that never leaps."""
        return self.clock.monotonic_ns() / 1e9


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
