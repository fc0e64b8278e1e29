"""Two robots with simulated devices share an arena."""

import math
from pathlib import Path

import pytest

from robbie_mp import ModuleHarness, SettingError
from robbie_mp.messages import LaserScan, Odometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.robot_places import RobotPlaces
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.devices.laser import SimulatedLaserRangeFinder
from tests._support.places import ARENAS

SETTINGS = {"arena": str(ARENAS / "rescue_small.yaml"), "start": [1.5, 1.75, 0.0]}


def test_robot_starts_where_the_profile_says_and_the_laser_sees_other_robots(tmp_path: Path) -> None:
    settings = {**SETTINGS, "shared": str(tmp_path)}
    other = RobotPlaces(tmp_path, "blue")
    other.tell(Pose(0.9, 1.75, 0.0))
    with (
        ModuleHarness(SimulatedBase, settings) as base,
        ModuleHarness(SimulatedLaserRangeFinder, {**settings, "noise_m": 0.0}) as laser,
    ):
        base.advance(0.1)
        assert other.others().tolist() == [[1.5, 1.75]]
        truth = base.take(Odometry, "ground_truth")[-1]
        assert truth.pose.pose.position.x == pytest.approx(0.0, abs=1e-9), "its map begins at its start"
        laser.send(truth, topic="ground_truth")
        laser.advance(0.2)
        scan = laser.take(LaserScan)[-1]
        behind = round((-math.pi - scan.angle_min) / scan.angle_increment) % len(scan.ranges)
        assert scan.ranges[behind] == pytest.approx(0.4, abs=0.02)
    assert other.others().shape == (0, 2)


def test_start_that_is_no_pose_is_explained() -> None:
    with pytest.raises(SettingError, match="expected x, y"):
        ModuleHarness(SimulatedBase, {**SETTINGS, "start": [1.0]})
