"""An arena in which things change: temporary obstacles, people and doors."""

from collections.abc import Sequence

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.doors import Doors
from robbie_robots.hw.simulation.people import STEP_S, WalkingPeople

# No obstacle appears nearer than this to the robot, so that it can stop.
APART_M = 0.6


class ChangingArena:
    """Tracks which temporary obstacles are present, moves people, and turns doors.

    An obstacle that is due where the robot stands appears as soon as the robot has left. People open the
    doors on their ways.

    Args:
        arena: the world.
        body_radius_m: the robot's radius.
        obstacles: indices of the obstacles that are present already.
        people: where people are, as `WalkingPeople.states`; by default where they begin.
        doors: how far doors are open, as `Doors.states`; by default as at the start.
    """

    def __init__(
        self,
        arena: Arena,
        body_radius_m: float,
        obstacles: tuple[int, ...] = (),
        people: Sequence[Sequence[float]] = (),
        doors: Sequence[Sequence[float]] = (),
    ) -> None:
        self._empty = arena
        self._body_radius_m = body_radius_m
        self.obstacles = obstacles
        self.doors = Doors(arena.doors, doors)
        self.people = WalkingPeople(arena.people, people, self.doors)
        self.arena = arena.with_obstacles(obstacles).with_doors(self.doors.opened_rad)
        self._steps = -1

    def change(self, elapsed_s: float, robot: Pose) -> None:
        """Bring everything to a time.

        Args:
            elapsed_s: time since the start of the simulation.
            robot: where the robot is, arena frame.
        """
        apart_m = self._body_radius_m + APART_M
        there = tuple(
            index
            for index, obstacle in enumerate(self._empty.appearing)
            if obstacle.from_s <= elapsed_s < obstacle.until_s
            and (index in self.obstacles or obstacle.distance_m(*robot[:2]) >= apart_m)
        )
        if self._move(elapsed_s, robot) or there != self.obstacles:
            self.obstacles = there
            self.arena = self._empty.with_obstacles(there).with_doors(self.doors.opened_rad)

    def _move(self, elapsed_s: float, robot: Pose) -> bool:
        """Move people and doors in turns, so that nothing depends on how often this is called.

        Returns:
            Whether a door has moved.
        """
        last = int(elapsed_s / STEP_S + 1e-6)
        first = last if self._steps < 0 else self._steps + 1
        self._steps = max(self._steps, last)
        have_turned = False
        for step in range(first, last + 1):
            self.people.walk_until(step * STEP_S, robot)
            shown = self.people.shown.tolist()
            have_turned |= self.doors.turn_until(step * STEP_S, robot, self._body_radius_m, shown)
        return have_turned
