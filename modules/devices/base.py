"""The robot's base: passes drive commands to the drive and publishes wheel odometry."""

import json
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np

from hw.pose import Pose as Pose2D
from hw.simulation.arena_file import read_arena
from hw.simulation.drive import SimulatedDrive, WorldState
from modules.devices.commanded_base import CommandedBase, odometry
from modules.devices.simulated_world import SimulatedDevice
from robbie_mp import Header, Time, setting
from robbie_mp.messages import SimulatedWorld
from workers.planar_pose import relative


class SimulatedBase(CommandedBase, SimulatedDevice):
    """The base of a simulated robot. It also publishes the robot's true pose, on topic `ground_truth`.

    The map frame has its origin at the robot's start, as a real robot's odometry does.

    A drive command expires: if no newer one arrives in time, the drive stops, even if the module that sent
    it has died. An emergency stop latches and survives a restart: the robot stands still until it receives
    an `EmergencyStop` with `engaged` false. After a restart of the base, the robot is at rest where it was
    at the last tick.

    Publishes `Odometry` on `odom` and `ground_truth`, `EmergencyStop` on `emergency_stop_state`, and, if the
    arena has temporary obstacles, `SimulatedWorld` on `ground_truth`.
    """

    drive: SimulatedDrive

    seed: int = setting(0, "random seed of the wheels' slip")
    period_s: float = setting(0.05, "time between odometry messages", minimum=0.005)

    def setup(self) -> None:
        """Put the robot at the arena's start, or where it was before the restart."""
        arena = read_arena(self.arena)
        self.start = arena.start
        self.changes = bool(arena.appearing)
        resumed = None if self.restored is None else world_of(self.restored)
        self.drive = SimulatedDrive(arena, self.monotonic_s, seed=self.seed, resumed=resumed)
        self.stop_reason = "engaged before a restart" if self.drive.is_emergency_stopped else ""
        self.obey()

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
        self.confirm()
        self.status = (
            f"{'EMERGENCY STOP, ' if self.drive.is_emergency_stopped else ''}"
            f"{state.linear_m_per_s:.2f} m/s, {state.angular_rad_per_s:.2f} rad/s, "
            f"{self.drive.collisions} collisions, {self.drive.expired_commands} expired commands"
        )

    def confirm(self) -> None:
        """Checkpoint the world and publish the emergency stop's state, so that both survive a restart."""
        self.checkpoint(state_of(self.drive.world_state()))
        super().confirm()

    def teardown(self) -> None:
        """Stop the robot; write collisions, expired commands and distance from the start to `base.json`."""
        self.drive.stop()
        counted = {
            "collisions": self.drive.collisions,
            "expired_commands": self.drive.expired_commands,
            "from_start_m": math.dist(self.drive.ground_truth().pose[:2], self.start[:2]),
        }
        (self.output_directory / "base.json").write_text(json.dumps(counted) + "\n")


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
