"""Two robots whose ways cross do not touch, although neither knows of the other but by its laser."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from tests.workers._support.navigation_world import NavigationWorld

LIMIT_S = 12.0


def room(start: Pose) -> Arena:
    corners = np.array([(0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0)])
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    return Arena(walls, np.empty((0, 3)), start, 6.0, 6.0)


def position(world: NavigationWorld) -> NDArray[np.float64]:
    return np.array(world.drive.ground_truth().pose[:2])


@pytest.mark.slow
def test_robots_whose_ways_cross_do_not_touch() -> None:
    east, north = Pose(1.5, 3.0, 0.0), Pose(3.15, 1.35, math.pi / 2)
    robots = [NavigationWorld(room(start)) for start in (east, north)]
    for robot, goal in zip(robots, [(5.5, 3.0, 0.0), (3.15, 5.5, math.pi / 2)], strict=True):
        robot.navigator.go_to(goal)
    nearest_m = math.inf
    while robots[0].now_s < LIMIT_S:
        places = [position(robot) for robot in robots]
        nearest_m = min(nearest_m, math.dist(*places))
        for robot, other in zip(robots, reversed(places), strict=True):
            robot.meet(other[None])
            robot.run(0.1)
    assert [robot.drive.collisions for robot in robots] == [0, 0]
    assert nearest_m < 1.0, "they have not met"
