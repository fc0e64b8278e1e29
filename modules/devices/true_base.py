"""Base of the modules that own the true pose of a simulated robot."""

import json
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np

from robbie_mp import CallRefused, Header, Time, setting
from robbie_mp.messages import SimulatedWorld
from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.pose import Pose as Pose2D
from robbie_robots.hw.simulation.differential_drive import DifferentialDrive
from robbie_robots.hw.simulation.drive import SimulatedDrive, WorldState
from robbie_robots.modules.devices.commanded_base import odometry
from robbie_robots.modules.devices.simulated_world import (
    DoorMoved,
    MoveDoor,
    SimulatedDevice,
    SimulatedDoors,
    SimulatedPeople,
)
from robbie_robots.workers.planar_pose import relative
from robbie_robots.workers.row_log import RowLog

MAX_PATH_ROWS = 200_000
"""More than an hour of the true path, at 50 poses each second."""


class TrueBase(SimulatedDevice):
    """A module with the drive of a simulated robot in an arena.

    A subclass calls `enter_arena` in `setup`, `publish_truth` in `tick` and `write_results` in `teardown`.
    """

    drive: SimulatedDrive

    seed: int = setting(0, "random seed of the wheels' slip")
    period_s: float = setting(0.05, "time between odometry messages", minimum=0.005)
    true_path: bool = setting(False, "write the true path to truth.txt: lines of t x y theta (s, m, m, rad)")

    def enter_arena(self, body: DifferentialDrive | None = None) -> None:
        """Put the robot at the arena's start, or where it was before a restart."""
        self.world = self.read_arena()
        self.places = self.robot_places()
        self.path = RowLog(4, MAX_PATH_ROWS)
        resumed = None if self.restored is None else world_of(self.restored)
        clock = self.clock
        self.drive = SimulatedDrive(
            self.world,
            lambda: clock.monotonic_ns() / 1e9,
            seed=self.seed,
            body=body,
            resumed=resumed,
            others=None if self.places is None else self.places.others,
        )

        if self.world.doors:
            self.opened_rad: list[float] = []
            self.serve(MoveDoor, self.on_move_door)

    def on_move_door(self, request: MoveDoor) -> DoorMoved:
        """Open or close a door from now on."""
        if not self.drive.doors.want(request.door, is_open=request.open):
            names = ", ".join(door.name for door in self.world.doors)
            raise CallRefused(f"there is no door {request.door!r:.80}; there are: {names}")
        return DoorMoved()

    def publish_truth(self, truth: DriveState, stamp: Time) -> None:
        """Publish the true state; first where the arena's people are, and which doors have turned.

        So a device that hears of a state knows where people were at its time.
        """
        if self.places is not None:
            self.places.tell(truth.pose)
        if self.world.people:
            rows = self.drive.people.ravel()
            people = SimulatedPeople(header=Header(stamp=stamp, frame_id="arena"), shown=rows)
            self.publish(people, topic="ground_truth")
        if self.world.doors and self.opened_rad != self.drive.doors.opened_rad:
            self.opened_rad = list(self.drive.doors.opened_rad)
            doors = SimulatedDoors(
                header=Header(stamp=stamp, frame_id="arena"), opened=np.array(self.opened_rad)
            )
            self.publish(doors, topic="ground_truth", latched=True)
        truth = replace(truth, pose=Pose2D(*relative(self.world.start, truth.pose)))
        self.publish(odometry(truth, stamp, "map"), topic="ground_truth")
        if self.true_path:
            self.path.add((stamp.nanoseconds / 1e9, *truth.pose))
        if self.world.appearing:
            header = Header(stamp=stamp, frame_id="base_link")
            obstacles = np.array(self.drive.obstacles, np.uint32)
            self.publish(SimulatedWorld(header=header, obstacles=obstacles), topic="ground_truth")

    def write_results(self) -> None:
        """Write what was counted and the distance from the start to `base.json`; leave the arena.

        Counted are collisions, those with people (`touches`), and expired commands.

        Write the true path to `truth.txt`, in the map's frame, if a setting says so.
        """
        counted = {
            "collisions": self.drive.collisions,
            "touches": self.drive.touches,
            "expired_commands": self.drive.expired_commands,
            "from_start_m": math.dist(self.drive.ground_truth().pose[:2], self.world.start[:2]),
        }
        if self.places is not None:
            self.places.leave()
        if self.true_path:
            with self.result_file("truth.txt") as file:
                np.savetxt(file, self.path.rows, "%.6f")
        self.write_result("base.json", json.dumps(counted) + "\n")


def state_of(world: WorldState) -> dict[str, object]:
    """Return a simulated world as plain data."""
    return {field.name: getattr(world, field.name) for field in fields(world)} | {
        "true_pose": tuple(world.true_pose),
        "odometry": tuple(world.odometry),
    }


def world_of(state: dict[str, Any]) -> WorldState:
    """Return the world that `state_of` described."""
    poses = {"true_pose": Pose2D(*state["true_pose"]), "odometry": Pose2D(*state["odometry"])}
    names = {field.name for field in fields(WorldState)}
    return WorldState(**{name: value for name, value in (state | poses).items() if name in names})
