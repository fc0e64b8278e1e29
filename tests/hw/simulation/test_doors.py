"""Simulated doors turn, stop before they touch somebody, stand in the robot's way, and people open them."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import ArenaPerson
from robbie_robots.hw.simulation.arena_file import ArenaError, read_arena
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.changing_arena import ChangingArena
from robbie_robots.hw.simulation.doors import Door, Doors
from robbie_robots.hw.simulation.drive import SimulatedDrive, WorldState
from tests._support.places import ARENAS

RADIUS_M = 0.2
FAR_AWAY = Pose(0.5, 9.5, 0.0)
# A wall at x = 5 with an opening from y = 4.5 to 5.5; the door in it turns to the left.
DOOR = Door("study", (5.0, 4.5), (5.0, 5.5), math.pi / 2)
WALLS = np.concatenate(
    [box_segments(np.array([[0.0, 0.0, 10.0, 10.0]])), [[5.0, 0.0, 5.0, 4.5], [5.0, 5.5, 5.0, 10.0]]]
)
HOUSE = Arena(WALLS, np.empty((0, 3)), Pose(1.0, 5.0, 0.0), 10.0, 10.0, 2.4, doors=(DOOR,))
ANNA = ArenaPerson("Anna", ((2.0, 5.2, 0.0), (8.0, 5.2, 0.0)), speed_m_per_s=0.6)


def turned(doors: Doors, for_s: float, robot: Pose = FAR_AWAY) -> float:
    doors.turn_until(0.0, robot, RADIUS_M, ())
    doors.turn_until(for_s, robot, RADIUS_M, ())
    return doors.opened_rad[0]


def test_door_turns_until_it_is_open_and_until_it_is_closed_again() -> None:
    doors = Doors([DOOR])
    assert turned(doors, 5.0) == 0.0
    assert doors.want("study", is_open=True)
    doors.turn_until(5.5, FAR_AWAY, RADIUS_M, ())
    assert 0.0 < doors.opened_rad[0] < DOOR.opens_rad
    doors.turn_until(9.0, FAR_AWAY, RADIUS_M, ())
    assert doors.opened_rad == [DOOR.opens_rad]
    assert doors.leaves[0].tolist() == pytest.approx([5.0, 4.5, 4.0, 4.5])
    doors.want("study", is_open=False)
    doors.turn_until(12.0, FAR_AWAY, RADIUS_M, ())
    assert doors.leaves[0].tolist() == pytest.approx([5.0, 4.5, 5.0, 5.5])
    assert not doors.want("cellar", is_open=True)


def test_door_waits_until_the_robot_has_left_its_way() -> None:
    doors = Doors([DOOR])
    doors.want("study", is_open=True)
    stopped = turned(doors, 9.0, Pose(4.4, 5.1, 0.0))
    assert 0.0 < stopped < DOOR.opens_rad
    leaf = doors.leaves[0]
    assert replace(HOUSE, segments=leaf[None]).clearance_m(np.array([4.4, 5.1])) >= RADIUS_M
    doors.turn_until(18.0, FAR_AWAY, RADIUS_M, ())
    assert doors.opened_rad == [DOOR.opens_rad]


def test_closed_door_stops_robot_and_laser_and_an_open_one_does_not() -> None:
    time_s = 0.0
    drive = SimulatedDrive(replace(HOUSE, start=Pose(4.0, 5.0, 0.0)), lambda: time_s)
    beam = LaserGeometry(beams=1, angle_min_rad=0.0).angles_rad()
    for tenth in range(1, 40):
        time_s = tenth / 10
        drive.command(0.5, 0.0, 0.3)
    assert drive.ground_truth().pose.x_m < 5.0 - RADIUS_M
    assert drive.collisions == 1
    assert HOUSE.with_doors(drive.doors.opened_rad).ranges_m(4.0, 5.0, beam) == pytest.approx([1.0])

    drive = SimulatedDrive(replace(HOUSE, start=Pose(3.0, 5.0, 0.0)), lambda: time_s)
    drive.doors.want("study", is_open=True)
    for tenth in range(40, 110):
        time_s = tenth / 10
        drive.command(0.5 if tenth > 60 else 0.0, 0.0, 0.3)
    assert drive.ground_truth().pose.x_m > 5.0
    assert drive.collisions == 0
    assert HOUSE.with_doors(drive.doors.opened_rad).ranges_m(4.5, 5.0, beam) == pytest.approx([5.5])


def test_person_opens_the_door_on_the_way_waits_for_it_and_walks_through() -> None:
    world = ChangingArena(replace(HOUSE, people=(ANNA,)), RADIUS_M)
    for tenth in range(26):
        world.change(tenth / 10, FAR_AWAY)
    assert world.doors.opened_rad == [0.0]
    xs = []
    for tenth in range(26, 160):
        world.change(tenth / 10, FAR_AWAY)
        xs.append(world.people.states[0].x_m)
    assert world.doors.opened_rad == [DOOR.opens_rad]
    assert max(xs) == pytest.approx(8.0, abs=0.05)


def test_motion_of_people_and_doors_does_not_depend_on_how_often_it_is_asked_for() -> None:
    often, rarely = (ChangingArena(replace(HOUSE, people=(ANNA,)), RADIUS_M) for _ in range(2))
    rarely.change(0.0, FAR_AWAY)
    for hundredth in range(701):
        often.change(hundredth / 100, FAR_AWAY)
    rarely.change(7.0, FAR_AWAY)
    assert often.people.states == rarely.people.states
    assert often.doors.states == rarely.doors.states
    assert often.doors.opened_rad == [DOOR.opens_rad]


def test_restarted_drive_keeps_doors_as_they_are() -> None:
    time_s = 0.0
    drive = SimulatedDrive(HOUSE, lambda: time_s)
    time_s = 0.1
    drive.read()
    drive.doors.want("study", is_open=True)
    time_s = 0.6
    state = drive.world_state()
    again = SimulatedDrive(HOUSE, lambda: time_s, resumed=WorldState(state.true_pose, doors=state.doors))
    assert again.doors.opened_rad == drive.doors.opened_rad != [0.0]
    time_s = 0.7
    again.read()
    time_s = 4.0
    again.read()
    assert again.doors.opened_rad == [DOOR.opens_rad]


def test_apartment_has_two_doors_that_are_open() -> None:
    arena = read_arena(ARENAS / "apartment.yaml")
    assert [(door.name, door.is_open) for door in arena.doors] == [("bedroom", True), ("dressing", True)]
    for door in arena.doors:
        leaf = door.leaf(door.opens_rad)
        assert arena.clearance_m(np.linspace(leaf[:2], leaf[2:], 9)[2:]).min() > 0.03


@pytest.mark.parametrize(
    ("door", "error"),
    [
        ("{name: a, leaf: [1, 1, 1, 1], opens_rad: 1}", "must have a length"),
        ("{name: a, leaf: [1, 1, 2, 1], opens_rad: 0}", "opens_rad must be from -pi to pi and not 0"),
        ("{name: a, leaf: [1, 1, 2, 1], opens_rad: 1, open: 3}", "open must be true or false"),
        (
            "{name: a, leaf: [1, 1, 2, 1], opens_rad: 1}, {name: a, leaf: [1, 2, 2, 2], opens_rad: 1}",
            "another door has the name 'a' already",
        ),
    ],
)
def test_mistakes_in_doors_are_named(door: str, error: str, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(f"cell_m: 1.0\ndrawing: |\n  ####\n  #R.#\n  ####\ndoors: [{door}]\n")
    with pytest.raises(ArenaError, match=error):
        read_arena(tmp_path / "a.yaml")
