"""Mapping gives its pose as a guess while scans do not fit the map, and after the map was lost."""

from pathlib import Path

import numpy as np

from robbie_mp import ModuleHarness
from robbie_mp.messages import (
    ControlSet,
    ControlState,
    LaserScan,
    MappingState,
    Odometry,
    PoseStamped,
    PoseWithCovariance,
    SetControl,
)
from robbie_robots.modules.maps.mapping import Mapping
from tests.modules.maps.test_restored import DRIVE, drive, header, pose
from tests.workers._support.synthetic_room import ANGLE_MIN_RAD, INCREMENT_RAD, RANGE_MAX_M


def test_pose_is_a_guess_while_scans_do_not_fit_the_map(tmp_path: Path) -> None:
    elsewhere = np.where(np.arange(180) % 90 < 45, 0.6, 0.9) + 0.002 * np.arange(180)
    with ModuleHarness(Mapping, output_directory=tmp_path) as harness:
        drive(harness, 0, 100)
        assert harness.take(PoseStamped, "map_pose")
        assert not harness.take(PoseStamped, "map_pose_guess")
        harness.advance(1.0)
        known = harness.take(MappingState)[-1]
        assert (known.certain, known.gaps_open, known.share_beyond_gaps) == (True, 0, 0.0)
        assert 0.0 < known.spread_m < 0.1
        stamp_s, x_m, y_m, heading_rad = DRIVE.odometry[100].tolist()
        for number in range(2):
            stamp = header(stamp_s + 0.2 * number, "odom")
            there = PoseWithCovariance(pose=pose(x_m + 0.1, y_m + 0.1, heading_rad))
            harness.send(Odometry(header=stamp, pose=there), topic="odom")
            if number == 0:
                assert harness.take(PoseStamped, "map_pose")
                scan = LaserScan(
                    header=stamp,
                    angle_min=ANGLE_MIN_RAD,
                    angle_increment=INCREMENT_RAD,
                    range_min=0.05,
                    range_max=RANGE_MAX_M,
                    ranges=elsewhere,
                )
                harness.send(scan)
        assert harness.take(PoseStamped, "map_pose_guess")
        assert not harness.take(PoseStamped, "map_pose")
        harness.advance(1.0)
        lost = harness.take(MappingState)[-1]
        assert not lost.certain
        assert lost.spread_m > 1.0
        assert lost.spread_rad > 0.3


def test_robot_whose_map_is_lost_holds_before_it_gets_a_pose_on_the_new_one(tmp_path: Path) -> None:
    """It drove to its goal as if that were on the new map, which begins where the robot is."""
    with ModuleHarness(Mapping, output_directory=tmp_path, checkpoint_lost=True) as harness:
        drive(harness, 0, 20)
        harness.advance(1.0)
        (order,) = harness.take(SetControl)
        assert (order.mode, "the map was lost" in order.reason) == (ControlState.HOLD, True)
        assert harness.take(PoseStamped, "map_pose_guess") and not harness.take(PoseStamped, "map_pose")
        kept = harness.checkpoint
        harness.reply(order, ControlSet(mode=ControlState.HOLD))
        drive(harness, 20, 40)
        assert harness.take(PoseStamped, "map_pose")
    with ModuleHarness(Mapping, output_directory=tmp_path, restored=kept) as killed_meanwhile:
        killed_meanwhile.advance(0.1)
        assert killed_meanwhile.take(SetControl)
