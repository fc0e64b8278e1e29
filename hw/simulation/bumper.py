"""A simulated bumper in an arena."""

import math

import numpy as np

from robbie_robots.hw.bumper import PARTS, Bumper, Contact
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena

# Two rays are less than a centimetre apart where they leave the stock robot's body.
RAYS = 180


class BumperNotPlaced(RuntimeError):
    """The simulated bumper was read before it was placed."""


class SimulatedBumper(Bumper):
    """A bumper that touches everything nearer to the robot's body than its travel.

    Args:
        arena: the world; you may replace it when it changes.
        body_radius_m: the robot's radius.
        travel_m: the bumper's overhang; must exceed the distance that the robot moves in one simulation step.
    """

    def __init__(self, arena: Arena, body_radius_m: float = 0.20, travel_m: float = 0.012) -> None:
        self.arena = arena
        self._reach_m = body_radius_m + travel_m
        self._placed: tuple[Pose, float] | None = None

    def place(self, robot: Pose, stamp_s: float) -> None:
        """Put the bumper's robot at a true pose.

        Args:
            robot: pose of the robot, arena frame.
            stamp_s: when the robot was there.
        """
        self._placed = (robot, stamp_s)

    def read(self) -> Contact:
        """Return the contacts at the last place.

        Raises:
            BumperNotPlaced: `place` has not been called.
        """
        if self._placed is None:
            raise BumperNotPlaced("the simulated bumper has no pose: call place() before read()")
        robot, stamp_s = self._placed
        if self.arena.clearance_m(np.array(robot[:2])) >= self._reach_m:
            return Contact(stamp_s, ())
        directions = (np.arange(RAYS) + 0.5) * 2 * math.pi / RAYS
        ranges = self.arena.ranges_m(robot.x_m, robot.y_m, directions + robot.heading_rad)
        touched = np.flatnonzero(ranges < self._reach_m)
        # The parts are quarters, counter-clockwise from straight ahead.
        return Contact(stamp_s, tuple(PARTS[part] for part in np.unique(touched * len(PARTS) // RAYS)))
