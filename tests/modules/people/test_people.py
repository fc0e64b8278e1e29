"""Persons are found in laser scans; what the map shows is told apart from them."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from robbie_mp import Header, ModuleHarness, Time
from robbie_mp.messages import (
    LaserScan,
    MapMetaData,
    OccupancyGrid,
    Point,
    Pose,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import Pose as RobotPose
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.hw.simulation.people import leg_circles
from robbie_robots.modules.people.messages import People
from robbie_robots.modules.people.people import PEOPLE, THINGS, PeopleFinder
from tests._support.places import ARENAS

LASER = LaserGeometry(angle_increment_rad=0.00613592, beams=1024)
AHEAD_M = 1.2


def stamp(finder: ModuleHarness[PeopleFinder], frame: str) -> Header:
    return Header(stamp=Time.from_nanoseconds(finder.module.clock.now_ns()), frame_id=frame)


def look(finder: ModuleHarness[PeopleFinder], scans: int) -> tuple[list[str], list[str]]:
    """Show somebody who stands ahead, and return the newest names of persons and of things."""
    arena = read_arena(ARENAS / "apartment.yaml")
    robot = arena.start
    standing = leg_circles(np.array([[robot.x_m + AHEAD_M, robot.y_m, 1.5, 0, 0]]))
    laser = SimulatedLaser(arena.with_circles(standing), LASER, noise_m=0.005, seed=2)
    laser.place(RobotPose(*robot), 0.0)
    for _ in range(scans):
        there = TransformStamped(
            header=stamp(finder, "map"),
            child_frame_id="laser",
            transform=Transform(rotation=Quaternion(w=1.0)),
        )
        finder.send(TFMessage(transforms=[there]), topic="tf")
        ranges = laser.scan().ranges_m
        finder.send(
            LaserScan(
                header=stamp(finder, "laser"),
                angle_min=LASER.angle_min_rad,
                angle_increment=LASER.angle_increment_rad,
                range_max=LASER.range_max_m,
                ranges=ranges,
            )
        )
        finder.advance(0.1)
    newest = [finder.take(People, topic=topic)[-1].people for topic in (PEOPLE, THINGS)]
    persons, things = (
        [one.name for one in told if abs(one.position.x - AHEAD_M) < 0.2 and abs(one.position.y) < 0.2]
        for told in newest
    )
    return persons, things


def test_somebody_who_stands_there_is_a_person_until_the_map_shows_a_thing() -> None:
    with ModuleHarness(PeopleFinder) as finder:
        assert look(finder, 8) == (["1"], [])
        cells = np.zeros((80, 80), np.int8)
        cells[36:44, 58:66] = 100
        info = MapMetaData(width=80, height=80, resolution=0.05, origin=Pose(position=Point(x=-2.0, y=-2.0)))
        finder.send(OccupancyGrid(header=stamp(finder, "map"), info=info, data=cells.ravel()))
        assert look(finder, 12) == ([], ["1"])


FIELD = LaserGeometry(angle_min_rad=-2.0923487, angle_increment_rad=0.00613592, beams=683)
LASERS = {"laser": FIELD, "rear_laser": replace(FIELD, mount=RobotPose(-0.175, 0.0, math.pi))}


def find(people: Sequence[tuple[float, float]], topics: Sequence[str]) -> list[tuple[float, float]]:
    """Return where a robot with two lasers finds those who stand around it; it hears the scans on topics."""
    arena = read_arena(ARENAS / "apartment.yaml")
    robot = RobotPose(3.2, 4.2, 0.0)
    states = np.array([[robot.x_m + x_m, robot.y_m + y_m, 1.5, 0, 0] for x_m, y_m in people])
    there = replace(arena, segments=arena.segments[:0]).with_circles(leg_circles(states))
    with ModuleHarness(PeopleFinder) as finder:
        for _ in range(12):
            header = stamp(finder, "map")
            at = [
                TransformStamped(
                    header=header,
                    child_frame_id=frame,
                    transform=Transform(
                        translation=Vector3(x=laser.mount.x_m),
                        rotation=Quaternion.from_yaw(laser.mount.heading_rad),
                    ),
                )
                for frame, laser in LASERS.items()
            ]
            finder.send(TFMessage(transforms=at), topic="tf")
            for topic, (frame, geometry) in zip(("scan", "rear_scan"), LASERS.items(), strict=True):
                if topic in topics:
                    laser = SimulatedLaser(there, geometry, noise_m=0.005, seed=2)
                    laser.place(robot, 0.0)
                    scan = LaserScan(
                        header=stamp(finder, frame),
                        angle_min=geometry.angle_min_rad,
                        angle_increment=geometry.angle_increment_rad,
                        range_max=geometry.range_max_m,
                        ranges=laser.scan().ranges_m,
                    )
                    finder.send(scan, topic=topic)
            finder.advance(0.1)
        told = finder.take(People, topic=PEOPLE)[-1].people
    return sorted((one.position.x, one.position.y) for one in told)


def test_person_behind_the_robot_is_found_by_the_legs_in_the_rear_lasers_scans() -> None:
    behind = (-1.2, 0.1)
    assert find([behind], ["scan"]) == []
    (found,) = find([behind], ["scan", "rear_scan"])
    assert found == pytest.approx(behind, abs=0.1)


def test_person_whom_both_lasers_see_is_one_person() -> None:
    beside = [(-0.1, 1.3), (0.0, -1.5)]
    for topics in (["scan"], ["rear_scan"], ["scan", "rear_scan"]):
        found = find(beside, topics)
        np.testing.assert_allclose(found, beside, atol=0.12)
