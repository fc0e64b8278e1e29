"""The simulated bumper detects contacts and their side."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robbie_robots.hw.pose import ORIGIN, Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.bumper import BumperNotPlaced, SimulatedBumper
from robbie_robots.hw.simulation.drive import SimulatedDrive, WorldState

ROOM = Arena(box_segments(np.array([[0.0, 0.0, 4.0, 4.0]])), np.empty((0, 3)), ORIGIN, 4.0, 4.0)


def pressed(robot: Pose, arena: Arena = ROOM) -> set[str]:
    bumper = SimulatedBumper(arena)
    bumper.place(robot, 7.0)
    contact = bumper.read()
    assert contact.stamp_s == 7.0
    return set(contact.pressed)


@pytest.mark.parametrize(
    ("robot", "parts"),
    [
        (Pose(2.0, 2.0, 0.0), set()),
        (Pose(3.78, 2.0, 0.0), set()),
        (Pose(3.795, 2.0, 0.0), {"front_left", "front_right"}),
        (Pose(3.795, 2.0, math.pi), {"back_left", "back_right"}),
        (Pose(2.0, 3.795, 0.0), {"front_left", "back_left"}),
        (Pose(2.0, 3.795, -math.pi / 4), {"back_left"}),
        (Pose(2.0, 0.205, math.pi / 4), {"back_right"}),
        (Pose(2.0, 0.205, -math.pi / 4), {"front_right"}),
    ],
)
def test_parts_on_the_side_of_the_contact_are_pressed(robot: Pose, parts: set[str]) -> None:
    assert pressed(robot) == parts


def test_round_post_presses_the_bumper() -> None:
    post = replace(ROOM, circles=np.array([[2.28, 2.12, 0.1]]))
    assert pressed(Pose(2.0, 2.0, 0.0), post) == {"front_left"}
    assert pressed(Pose(1.9, 2.0, 0.0), post) == set()


@pytest.mark.parametrize("heading_rad", np.linspace(-1.2, 1.2, 7))
def test_robot_stopped_by_a_wall_presses_the_bumper(heading_rad: float) -> None:
    now = [0.0]
    drive = SimulatedDrive(ROOM, lambda: now[0], resumed=WorldState(Pose(3.5, 2.0, heading_rad)))
    while now[0] < 8.0:
        drive.command(0.8, 0.0, 0.5)
        now[0] += 0.4
    assert drive.read().linear_m_per_s == 0.0
    bumper = SimulatedBumper(ROOM)
    bumper.place(drive.ground_truth().pose, now[0])
    assert any(part.startswith("front") for part in bumper.read().pressed)


def test_reading_a_bumper_before_it_is_placed_is_an_error() -> None:
    with pytest.raises(BumperNotPlaced, match="place"):
        SimulatedBumper(ROOM).read()
