"""An arena with temporary obstacles."""

from hw.pose import Pose
from hw.simulation.arena import Arena

# No obstacle appears nearer than this to the robot, so that it can stop.
APART_M = 0.6


class ChangingArena:
    """Tracks which temporary obstacles are present.

    An obstacle that is due where the robot stands appears as soon as the robot has left.

    Args:
        arena: the world.
        body_radius_m: the robot's radius.
        obstacles: indices of the obstacles that are present already.
    """

    def __init__(self, arena: Arena, body_radius_m: float, obstacles: tuple[int, ...] = ()) -> None:
        self._empty = arena
        self._apart_m = body_radius_m + APART_M
        self.obstacles = obstacles
        self.arena = arena.with_obstacles(obstacles)

    def change(self, elapsed_s: float, robot: Pose) -> None:
        """Update which obstacles are present.

        Args:
            elapsed_s: time since the start of the simulation.
            robot: where the robot is, arena frame.
        """
        there = tuple(
            index
            for index, obstacle in enumerate(self._empty.appearing)
            if obstacle.from_s <= elapsed_s < obstacle.until_s
            and (index in self.obstacles or obstacle.distance_m(*robot[:2]) >= self._apart_m)
        )
        if there != self.obstacles:
            self.obstacles = there
            self.arena = self._empty.with_obstacles(there)
