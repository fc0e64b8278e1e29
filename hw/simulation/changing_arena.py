"""An arena whose appearing obstacles come and go."""

from hw.pose import Pose
from hw.simulation.arena import Arena

# No obstacle comes nearer than this to the robot: it must be able to stop.
APART_M = 0.6


class ChangingArena:
    """Knows which obstacles are there now; it belongs to who knows where the robot is.

    An obstacle that is due where the robot stands comes as soon as the robot has left.

    Args:
        arena: the world.
        body_radius_m: the robot's.
        obstacles: indices of the obstacles that are there already.
    """

    def __init__(self, arena: Arena, body_radius_m: float, obstacles: tuple[int, ...] = ()) -> None:
        self._empty = arena
        self._apart_m = body_radius_m + APART_M
        self.obstacles = obstacles
        self.arena = arena.with_obstacles(obstacles)

    def change(self, elapsed_s: float, robot: Pose) -> None:
        """Let obstacles come and go.

        Args:
            elapsed_s: since the world began.
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
