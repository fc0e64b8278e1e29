"""The module of localisation, with a simulated robot in a building it has a map of."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import Header, ModuleHarness, Time
from robbie_mp.messages import (
    LaserScan,
    LocalizationState,
    MapMetaData,
    OccupancyGrid,
    Odometry,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    TimeJump,
)
from robbie_robots.hw.pose import Pose as PlanarPose
from robbie_robots.hw.simulation.random_rooms import drawn_map
from robbie_robots.modules.maps.localization import FEW_UNPLACED, UNPLACED, MonteCarloLocalization
from robbie_robots.modules.maps.planar_messages import planar
from robbie_robots.workers.maps.map_file import write_map
from robbie_robots.workers.maps.turned_grid import axis_aligned
from tests._support.present import present
from tools.trials.driving.localization import RESOLUTION_M, Conditions, DrivenRobot

Harness = ModuleHarness[MonteCarloLocalization]


@pytest.fixture
def drive() -> DrivenRobot:
    return DrivenRobot(1, Conditions(width_m=8.0, height_m=6.0))


@pytest.fixture
def map_file(drive: DrivenRobot, tmp_path: Path) -> Path:
    cells, corner = drawn_map(drive.arena, RESOLUTION_M)
    write_map(tmp_path / "map.yaml", cells, RESOLUTION_M, corner)
    return tmp_path / "map.yaml"


def pose_of(x_m: float, y_m: float, heading_rad: float) -> Pose:
    return Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(heading_rad))


def along(
    drive: DrivenRobot, harness: Harness, way_m: float, laser_ahead_s: float = 0.0
) -> Iterator[PlanarPose]:
    """Drive, and send the module what the robot's devices would say; yields the true poses."""
    for truth in drive.steps(way_m):
        wheels = drive.drive.read()
        stamp = Time.from_nanoseconds(round(wheels.stamp_s * 1e9))
        odometry = PoseWithCovariance(pose=pose_of(*wheels.pose))
        harness.send(Odometry(header=Header(stamp=stamp), pose=odometry), topic="odom")
        geometry, sweep = drive.laser.geometry, drive.laser.scan()
        taken = Time.from_nanoseconds(round((wheels.stamp_s + laser_ahead_s) * 1e9))
        harness.send(
            LaserScan(
                header=Header(stamp=taken),
                angle_min=geometry.angle_min_rad,
                angle_increment=geometry.angle_increment_rad,
                range_max=geometry.range_max_m,
                ranges=sweep.ranges_m,
            )
        )
        yield truth


def off_m(pose: PoseStamped, truth: PlanarPose) -> float:
    return float(np.hypot(pose.pose.position.x - truth[0], pose.pose.position.y - truth[1]))


@pytest.mark.slow
def test_pose_is_published_once_it_is_certain_and_survives_a_restart(
    drive: DrivenRobot, map_file: Path
) -> None:
    with ModuleHarness(MonteCarloLocalization, {"map_file": str(map_file)}) as harness:
        *_, truth = along(drive, harness, 2.5)
        states = harness.take(LocalizationState)
        assert not states[0].converged
        assert states[-1].converged
        assert off_m(harness.take(PoseStamped, "map_pose")[-1], truth) < 0.15
        assert harness.take(PoseStamped, "map_pose_guess")
        kept = harness.checkpoint
    with ModuleHarness(MonteCarloLocalization, {"map_file": str(map_file)}, restored=kept) as restarted:
        *_, truth = along(drive, restarted, 0.2)
        assert off_m(restarted.take(PoseStamped, "map_pose")[-1], truth) < 0.15
        assert not restarted.take(PoseStamped, "map_pose_guess")


@pytest.mark.parametrize("laser_ahead_s", [3600.0, 2.0, -3600.0])
def test_module_is_degraded_while_the_laser_has_another_clock(
    drive: DrivenRobot, map_file: Path, laser_ahead_s: float
) -> None:
    with ModuleHarness(MonteCarloLocalization, {"map_file": str(map_file)}) as harness:
        list(along(drive, harness, 0.2))
        assert not harness.module.degraded
        list(along(drive, harness, 1.0, laser_ahead_s))
        assert harness.module.degraded == UNPLACED
        assert harness.module.unplaced >= FEW_UNPLACED
        list(along(drive, harness, 0.5))
        assert not harness.module.degraded
        assert "scans without odometry" in harness.module.status


@pytest.mark.slow
def test_robot_is_localized_anew_when_time_jumps(drive: DrivenRobot, map_file: Path) -> None:
    with ModuleHarness(MonteCarloLocalization, {"map_file": str(map_file)}) as harness:
        list(along(drive, harness, 2.0))
        assert present(present(harness.module.localizer).newest).converged
        harness.send(TimeJump(reason="loop"))
        assert present(harness.module.localizer).pose is None
        *_, truth = along(drive, harness, 0.3)
        assert off_m(harness.take(PoseStamped, "map_pose_guess")[-1], truth) < 0.5


def turned(drive: DrivenRobot, yaw_rad: float) -> OccupancyGrid:
    """Return the map of the building as a grid with a turned origin."""
    cells, corner = drawn_map(drive.arena, RESOLUTION_M)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    x, y = np.asarray(corner, float)
    there = axis_aligned(cells, RESOLUTION_M, (c * x + s * y, c * y - s * x), -yaw_rad)
    cells, (x, y) = there[0], there[2]
    origin = pose_of(c * x - s * y, s * x + c * y, yaw_rad)
    info = MapMetaData(resolution=RESOLUTION_M, width=cells.shape[1], height=cells.shape[0], origin=origin)
    return OccupancyGrid(info=info, data=cells.ravel())


@pytest.mark.parametrize("is_file", [True, False])
def test_robot_is_localized_on_a_map_with_a_turned_origin(
    drive: DrivenRobot, tmp_path: Path, is_file: bool
) -> None:
    grid = turned(drive, 0.6)
    x_m, y_m, yaw_rad = planar(grid.info.origin)
    write_map(tmp_path / "map.yaml", grid.data.reshape(grid.info.height, -1), RESOLUTION_M, (x_m, y_m))
    text = (tmp_path / "map.yaml").read_text().replace("- 0.0\nnegate", f"- {yaw_rad}\nnegate")
    (tmp_path / "map.yaml").write_text(text)
    settings = {"map_file": str(tmp_path / "map.yaml")} if is_file else {}
    with ModuleHarness(MonteCarloLocalization, settings) as harness:
        if not is_file:
            harness.send(grid)
        harness.send(PoseStamped(pose=pose_of(*drive.arena.start)), topic="initial_pose")
        *_, truth = along(drive, harness, 0.5)
        assert off_m(harness.take(PoseStamped)[-1], truth) < 0.15


def test_map_and_first_pose_can_be_messages(drive: DrivenRobot) -> None:
    cells, corner = drawn_map(drive.arena, RESOLUTION_M)
    info = MapMetaData(
        resolution=RESOLUTION_M,
        width=cells.shape[1],
        height=cells.shape[0],
        origin=pose_of(float(corner[0]), float(corner[1]), 0.0),
    )
    with ModuleHarness(MonteCarloLocalization) as harness:
        assert harness.module.status == "waiting for the map"
        harness.send(OccupancyGrid(info=info, data=cells.ravel()))
        harness.send(PoseStamped(pose=pose_of(*drive.arena.start)), topic="initial_pose")
        *_, truth = along(drive, harness, 0.3)
        assert off_m(harness.take(PoseStamped)[-1], truth) < 0.3
