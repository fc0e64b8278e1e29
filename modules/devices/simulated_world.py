"""The world that the modules of simulated devices share."""

from collections.abc import Callable
from pathlib import Path

from hw.drive import DriveState
from hw.pose import Pose
from hw.simulation.arena_file import ArenaError, read_arena
from robbie_mp import REQUIRED, MessageHandling, Module, SettingError, Time, setting
from robbie_mp.messages import Odometry, SimulatedWorld


class SimulatedDevice(Module):
    """A module whose device lives in an arena."""

    arena: Path = setting(REQUIRED, "the arena file of the simulated world (YAML)", must_exist=True)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the arena, so that a mistake in it is reported before anything starts."""
        file = settings["arena"]
        assert isinstance(file, Path)
        try:
            read_arena(file)
        except (ArenaError, OSError) as error:
            raise SettingError(str(error), "arena") from error


class SharedWorld:
    """The arena and the robot's true state, as the simulated base publishes them on `ground_truth`.

    Args:
        module: the module of the device; it subscribes.
        file: the arena file.
        on_truth: called with every true state of the robot, pose in the arena frame; without it, only the
            newest state is delivered.
    """

    def __init__(
        self, module: Module, file: Path, on_truth: Callable[[DriveState], None] | None = None
    ) -> None:
        self._whole = read_arena(file)
        self._on_truth = on_truth
        self.arena = self._whole
        self.truth: DriveState | None = None
        """The robot's true state, pose in the arena frame; None before the base's first message."""
        self.stamp = Time()
        """The exact time of `truth`."""
        handling = MessageHandling.KEEP_ONLY_NEWEST if on_truth is None else MessageHandling.ALWAYS_DELIVER
        module.subscribe(Odometry, self._on_odometry, handling, topic="ground_truth")
        if self._whole.appearing:
            module.subscribe(SimulatedWorld, self._on_world, topic="ground_truth")

    def _on_odometry(self, message: Odometry) -> None:
        pose, twist = message.pose.pose, message.twist.twist
        robot = Pose(pose.position.x, pose.position.y, pose.orientation.yaw)
        self.stamp = message.header.stamp
        there = self._whole.start.plus(robot)
        self.truth = DriveState(self.stamp.nanoseconds / 1e9, there, twist.linear.x, twist.angular.z)
        if self._on_truth is not None:
            self._on_truth(self.truth)

    def _on_world(self, message: SimulatedWorld) -> None:
        self.arena = self._whole.with_obstacles(message.obstacles.tolist())
