"""The world that the modules of simulated devices share."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_mp import (
    DEFAULT,
    REQUIRED,
    Array,
    Header,
    Message,
    MessageHandling,
    Module,
    Reply,
    Request,
    SettingError,
    Time,
    float64,
    setting,
)
from robbie_mp.messages import Flaw, Odometry, SimulatedWorld
from robbie_mp.messages.flaws import MAX_POSITION_M, elements_beyond, wrong_size
from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import ArenaError, read_arena
from robbie_robots.hw.simulation.doors import Doors
from robbie_robots.hw.simulation.robot_places import RobotPlaces


class SimulatedPeople(Message, name="home_msgs/msg/SimulatedPeople", version=1):
    """Where the people of a simulated world truly are. Published by the simulated base."""

    header: Header = DEFAULT  # frame_id: arena
    shown: Array[float64] = DEFAULT  # (5 * people,): x (m), y (m), heading (rad), phase (rad), stride of each

    def flaw(self) -> Flaw | None:
        """Return whether not five numbers are known of each person, or one is not finite."""
        people = len(self.shown) // 5
        return wrong_size(self, "shown", 5 * people, "5 of each person") or elements_beyond(
            self, MAX_POSITION_M, "shown"
        )


class SimulatedDoors(Message, name="home_msgs/msg/SimulatedDoors", version=1):
    """How far the doors of a simulated world are truly open. Published by the simulated base."""

    header: Header = DEFAULT  # frame_id: arena
    opened: Array[float64] = DEFAULT  # (doors,), rad, from where each door is closed

    def flaw(self) -> Flaw | None:
        """Return an angle that is not finite."""
        return elements_beyond(self, math.tau, "opened")


class DoorMoved(Reply, name="home_msgs/srv/MoveDoor_Response", version=1):
    """The door begins to turn."""


class MoveDoor(Request[DoorMoved], name="home_msgs/srv/MoveDoor_Request", version=1):
    """Open or close a door of the simulated world, as somebody in it would."""

    door: str = DEFAULT
    open: bool = DEFAULT


class SimulatedDevice(Module):
    """A module whose device lives in an arena."""

    arena: Path = setting(REQUIRED, "the arena file of the simulated world (YAML)", must_exist=True)

    start: list[float] = setting(
        [], "this robot's x, y (m) and heading (rad) at the start, arena frame; []: the arena's start"
    )
    shared: Path | None = setting(
        None, "folder by which robots on this machine share the arena: they see and stop one another"
    )

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the arena, so that a mistake in it is reported before anything starts."""
        file = settings["arena"]
        assert isinstance(file, Path)
        try:
            read_arena(file)
        except ArenaError as error:
            raise SettingError(str(error), "arena") from error
        start = settings["start"]
        assert isinstance(start, list)
        if start and (len(start) != 3 or not all(map(math.isfinite, start))):
            raise SettingError(f"expected x, y (m) and heading (rad), not {start}", "start")

    def read_arena(self) -> Arena:
        """Return the arena, with this robot's start."""
        arena = read_arena(self.arena)
        return replace(arena, start=Pose(*self.start)) if self.start else arena

    def robot_places(self) -> RobotPlaces | None:
        """Return the places of the robots that share the arena; None if this robot is alone."""
        return None if self.shared is None else RobotPlaces(self.shared, self.run_id or "robot")


class SharedWorld:
    """The arena and the robot's true state, as the simulated base publishes them on `ground_truth`.

    Args:
        module: the module of the device; it subscribes.
        on_truth: called with every true state of the robot, pose in the arena frame; without it, only the
            newest state is delivered.
    """

    def __init__(self, module: SimulatedDevice, on_truth: Callable[[DriveState], None] | None = None) -> None:
        self._whole = module.read_arena()
        self._on_truth = on_truth
        self._obstacles: list[int] = []
        self._opened_rad = Doors(self._whole.doors).opened_rad
        self.arena = self._whole.with_doors(self._opened_rad)
        self.people: NDArray[np.float64] = np.empty((0, 5))
        """Where people are: (P, 5), as `robbie_robots.hw.simulation.people.PersonState.shown`."""
        self.truth: DriveState | None = None
        """The robot's true state, pose in the arena frame; None before the base's first message."""
        self.stamp = Time()
        """The exact time of `truth`."""
        handling = MessageHandling.KEEP_ONLY_NEWEST if on_truth is None else MessageHandling.ALWAYS_DELIVER
        module.subscribe(Odometry, self._on_odometry, handling, topic="ground_truth")
        if self._whole.appearing:
            module.subscribe(SimulatedWorld, self._on_world, topic="ground_truth")
        if self._whole.doors:
            module.subscribe(SimulatedDoors, self._on_doors, topic="ground_truth")
        if self._whole.people:
            module.subscribe(SimulatedPeople, self._on_people, handling, topic="ground_truth")

    def _on_odometry(self, message: Odometry) -> None:
        pose, twist = message.pose.pose, message.twist.twist
        robot = Pose(pose.position.x, pose.position.y, pose.orientation.yaw)
        self.stamp = message.header.stamp
        there = self._whole.start.plus(robot)
        self.truth = DriveState(self.stamp.nanoseconds / 1e9, there, twist.linear.x, twist.angular.z)
        if self._on_truth is not None:
            self._on_truth(self.truth)

    def _on_world(self, message: SimulatedWorld) -> None:
        self._obstacles = message.obstacles.tolist()
        self._change()

    def _on_doors(self, message: SimulatedDoors) -> None:
        if len(message.opened) == len(self._whole.doors):  # otherwise they are those of another arena
            self._opened_rad = message.opened.tolist()
            self._change()

    def _change(self) -> None:
        self.arena = self._whole.with_obstacles(self._obstacles).with_doors(self._opened_rad)

    def _on_people(self, message: SimulatedPeople) -> None:
        self.people = message.shown.reshape(-1, 5)
