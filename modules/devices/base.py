"""The robot's base: passes drive commands to the drive and publishes wheel odometry."""

import json
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np

from hw.drive import DriveCommandError, DriveState
from hw.pose import Pose as Pose2D
from hw.simulation.arena_file import read_arena
from hw.simulation.drive import SimulatedDrive, WorldState
from modules.devices.simulated_world import SimulatedDevice
from robbie_mp import Header, MessageHandling, Time, setting
from robbie_mp.messages import (
    BatteryState,
    DriveCommand,
    EmergencyStop,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    SimulatedWorld,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from workers.planar_pose import relative

MANUAL_TOPIC = "manual"


class SimulatedBase(SimulatedDevice):
    """The base of a simulated robot. It also publishes the robot's true pose, on topic `ground_truth`.

    The map frame has its origin at the robot's start, as a real robot's odometry does.

    A drive command expires: if no newer one arrives in time, the drive stops, even if the module that sent
    it has died. An emergency stop latches and survives a restart: the robot stands still until it receives
    an `EmergencyStop` with `engaged` false. After a restart of the base, the robot is at rest where it was
    at the last tick.

    Publishes `Odometry` on `odom` and `ground_truth`, `EmergencyStop` on `emergency_stop_state`, and, if the
    arena has temporary obstacles, `SimulatedWorld` on `ground_truth`.
    """

    seed: int = setting(0, "random seed of the wheels' slip")
    period_s: float = setting(0.05, "time between odometry messages", minimum=0.005)
    manual_hold_s: float = setting(
        2.0,
        "after a command on topic `manual`, commands from other topics are ignored for this time",
        minimum=0.0,
    )

    def setup(self) -> None:
        """Put the robot at the arena's start, or where it was before the restart."""
        arena = read_arena(self.arena)
        self.start = arena.start
        self.changes = bool(arena.appearing)
        resumed = None if self.restored is None else world_of(self.restored)
        self.drive = SimulatedDrive(arena, self._time_s, seed=self.seed, resumed=resumed)
        self.stop_reason = "engaged before a restart" if self.drive.is_emergency_stopped else ""
        self.manual_until_s = -math.inf
        self.subscribe(DriveCommand, self.on_command, optional=True)
        self.subscribe(EmergencyStop, self.on_emergency_stop, topic="emergency_stop", optional=True)
        self.subscribe(
            BatteryState, self.on_battery, MessageHandling.KEEP_ONLY_NEWEST, topic="battery", optional=True
        )

    def on_command(self, command: DriveCommand) -> None:
        """Follow the command while it is valid; manual commands take precedence over all others."""
        now_s = self._time_s()
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
        self._confirm()

    def on_battery(self, battery: BatteryState) -> None:
        """Engage the emergency stop when the battery is empty."""
        if battery.percentage <= 0 and not self.drive.is_emergency_stopped:
            self.stop_reason = "the battery is empty"
            self.drive.stop_for_emergency()
            self.log.error("the battery is empty: emergency stop")

    def tick(self) -> None:
        """Publish odometry, the true pose and the emergency stop's state; checkpoint them."""
        state, truth = self.drive.read(), self.drive.ground_truth()
        stamp = Time.from_nanoseconds(self.clock.now_ns())
        self.publish(odometry(state, stamp, "odom"), topic="odom")
        truth = replace(truth, pose=Pose2D(*relative(self.start, truth.pose)))
        self.publish(odometry(truth, stamp, "map"), topic="ground_truth")
        header = Header(stamp=stamp, frame_id="base_link")
        if self.changes:
            obstacles = np.array(self.drive.obstacles, np.uint32)
            self.publish(SimulatedWorld(header=header, obstacles=obstacles), topic="ground_truth")
        self._confirm()
        self.status = (
            f"{'EMERGENCY STOP, ' if self.drive.is_emergency_stopped else ''}"
            f"{state.linear_m_per_s:.2f} m/s, {state.angular_rad_per_s:.2f} rad/s, "
            f"{self.drive.collisions} collisions, {self.drive.expired_commands} expired commands"
        )

    def _confirm(self) -> None:
        """Checkpoint the world and publish the emergency stop's state, so that both survive a restart."""
        self.checkpoint(state_of(self.drive.world_state()))
        stamp = Time.from_nanoseconds(self.clock.now_ns())
        state = EmergencyStop(
            header=Header(stamp=stamp, frame_id="base_link"),
            engaged=self.drive.is_emergency_stopped,
            reason=self.stop_reason,
        )
        self.publish(state, topic="emergency_stop_state")

    def teardown(self) -> None:
        """Stop the robot; write collisions, expired commands and distance from the start to `base.json`."""
        self.drive.stop()
        counted = {
            "collisions": self.drive.collisions,
            "expired_commands": self.drive.expired_commands,
            "from_start_m": math.dist(self.drive.ground_truth().pose[:2], self.start[:2]),
        }
        (self.output_directory / "base.json").write_text(json.dumps(counted) + "\n")

    def _time_s(self) -> float:
        return self.clock.monotonic_ns() / 1e9


def state_of(world: WorldState) -> dict[str, object]:
    """Return a simulated world as plain data."""
    return {field.name: getattr(world, field.name) for field in fields(world)} | {
        "true_pose": tuple(world.true_pose),
        "odometry": tuple(world.odometry),
    }


def world_of(state: dict[str, Any]) -> WorldState:
    """Return the world that `state_of` described."""
    poses = {"true_pose": Pose2D(*state["true_pose"]), "odometry": Pose2D(*state["odometry"])}
    return WorldState(**state | poses)


def odometry(state: DriveState, stamp: Time, frame: str) -> Odometry:
    """Return the odometry message for a drive state."""
    pose = Pose(
        position=Point(x=state.pose.x_m, y=state.pose.y_m),
        orientation=Quaternion.from_yaw(state.pose.heading_rad),
    )
    twist = Twist(linear=Vector3(x=state.linear_m_per_s), angular=Vector3(z=state.angular_rad_per_s))
    return Odometry(
        header=Header(stamp=stamp, frame_id=frame),
        child_frame_id="base_link",
        pose=PoseWithCovariance(pose=pose),
        twist=TwistWithCovariance(twist=twist),
    )
