"""Robots in one arena find one another by a folder."""

from pathlib import Path

import numpy as np
import pytest

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation import robot_places
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.robot_places import RobotPlaces
from tests.hw.simulation.test_drive import EXACT, HALL, Clock, drive_for


def test_link_that_others_have_planted_in_the_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("a file of this user")
    (tmp_path / f"red{robot_places.SUFFIX}").symlink_to("victim")
    with pytest.raises(OSError, match="red"):
        RobotPlaces(tmp_path, "red").tell(Pose(1.0, 2.0, 0.5))
    assert (tmp_path / "victim").read_text() == "a file of this user"


def test_each_robot_knows_where_the_others_are_until_they_leave(tmp_path: Path) -> None:
    red, blue = RobotPlaces(tmp_path / "arena", "red"), RobotPlaces(tmp_path / "arena", "blue")
    red.tell(Pose(1.0, 2.0, 0.5))
    blue.tell(Pose(3.0, 4.0, 0.0))
    assert red.others().tolist() == [[3.0, 4.0]]
    blue.tell(Pose(3.5, 4.0, 0.0))
    assert red.others().tolist() == [[3.5, 4.0]]
    assert blue.others().tolist() == [[1.0, 2.0]]
    blue.leave()
    assert red.others().shape == (0, 2)


def test_robot_that_tells_nothing_for_long_is_gone_and_damaged_files_are_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    red, blue = RobotPlaces(tmp_path, "red"), RobotPlaces(tmp_path, "blue")
    (tmp_path / "green.place").write_bytes(b"damaged")
    blue.tell(Pose(3.0, 4.0, 0.0))
    assert len(red.others()) == 1
    monkeypatch.setattr(robot_places, "STALE_S", 0.0)
    assert len(red.others()) == 0


def test_another_robot_stops_this_one_as_a_wall_does(tmp_path: Path) -> None:
    clock = Clock()
    red, blue = RobotPlaces(tmp_path, "red"), RobotPlaces(tmp_path, "blue")
    blue.tell(Pose(11.0, 10.0, 0.0))
    drive = SimulatedDrive(HALL, clock, errors=EXACT, others=red.others)
    drive_for(drive, clock, 4.0, 0.5, 0.0)
    assert drive.ground_truth().pose.x_m == pytest.approx(10.6, abs=0.01)
    assert drive.collisions == 1
    assert HALL.with_robots(red.others(), 0.2).ranges_m(10.0, 10.0, np.zeros(1))[0] == pytest.approx(0.8)
