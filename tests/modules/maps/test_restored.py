"""Killed stock modules continue from their last checkpoint."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp import Duration, Header, ModuleHarness, Time
from robbie_mp.bus.checkpoint.errors import CheckpointTooLarge
from robbie_mp.messages import (
    DriveCommand,
    LaserScan,
    MapMetaData,
    OccupancyGrid,
    Odometry,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.maps.mapping import Mapping
from robbie_robots.modules.navigation.exploration import Exploration
from tests._support.commands import fresh
from tests._support.places import ARENAS
from tests._support.present import present
from tests.bus.checkpoint._support.states import same
from tests.workers._support.synthetic_room import ANGLE_MIN_RAD, INCREMENT_RAD, RANGE_MAX_M, Drive, measure

pytestmark = pytest.mark.slow

ARENA = ARENAS / "demo.yaml"
EVERY_SCAN = {"checkpoint_share": 1.0}
DRIVE = Drive.around_the_pillar(12.0)


def header(stamp_s: float, frame: str) -> Header:
    return Header(stamp=Time.from_nanoseconds(round(stamp_s * 1e9)), frame_id=frame)


def pose(x_m: float, y_m: float, heading_rad: float) -> Pose:
    return Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(heading_rad))


def drive(harness: ModuleHarness[Mapping], begin: int, end: int) -> None:
    """Odometry, a sweep with every fifth, and a look at the map now and then."""
    for number in range(begin, end):
        stamp_s, *place = DRIVE.odometry[number].tolist()
        odometry = PoseWithCovariance(pose=pose(*place))
        harness.send(Odometry(header=header(stamp_s, "odom"), pose=odometry), topic="odom")
        if number % 5 == 4:
            ranges = measure(DRIVE.true_at(stamp_s), np.random.default_rng(number))
            harness.send(
                LaserScan(
                    header=header(stamp_s, "laser"),
                    angle_min=ANGLE_MIN_RAD,
                    angle_increment=INCREMENT_RAD,
                    range_min=0.05,
                    range_max=RANGE_MAX_M,
                    ranges=ranges,
                )
            )
        if number % 100 == 98:
            harness.module.mapper.grid()


def begun(settings: dict[str, Any], folder: Path) -> ModuleHarness[Mapping]:
    """Begin a module that will be killed: it never ends its `with` block."""
    return ModuleHarness(Mapping, settings, output_directory=folder).__enter__()


def results(folder: Path) -> tuple[dict[str, Any], str]:
    return json.loads((folder / "mapping.json").read_text()), (folder / "trajectory.txt").read_text()


def test_limit_of_key_sweeps_is_a_setting_that_a_restart_may_change(tmp_path: Path) -> None:
    killed = begun(EVERY_SCAN | {"key_sweeps": 10}, tmp_path)
    drive(killed, 0, 400)
    assert killed.module.mapper.key_sweeps == 10
    wider = {"key_sweeps": 20}
    with ModuleHarness(Mapping, wider, output_directory=tmp_path, restored=killed.checkpoint) as restarted:
        drive(restarted, 400, 600)
        assert 10 < restarted.module.mapper.key_sweeps <= 20


def test_killed_mapping_restores_its_map_and_counters(tmp_path: Path) -> None:
    for name in ("straight", "killed"):
        (tmp_path / name).mkdir()
    with ModuleHarness(Mapping, EVERY_SCAN, output_directory=tmp_path / "straight") as straight:
        drive(straight, 0, 600)
    killed = begun(EVERY_SCAN, tmp_path / "killed")
    drive(killed, 0, 400)
    with ModuleHarness(
        Mapping, EVERY_SCAN, output_directory=tmp_path / "killed", restored=killed.checkpoint
    ) as restarted:
        drive(restarted, 400, 600)
        assert same(restarted.checkpoint, straight.checkpoint)
    counts, trajectory = results(tmp_path / "killed")
    assert (counts["scans"], counts["odometry_messages"]) == (120, 600)
    assert (counts, trajectory) == results(tmp_path / "straight")
    assert (tmp_path / "killed" / "map.png").read_bytes() == (tmp_path / "straight" / "map.png").read_bytes()


def test_restarted_mapping_publishes_its_map_at_once(tmp_path: Path) -> None:
    killed = begun(EVERY_SCAN, tmp_path)
    drive(killed, 0, 50)
    with ModuleHarness(Mapping, output_directory=tmp_path, restored=killed.checkpoint) as restarted:
        restarted.advance(0)
        assert restarted.take(OccupancyGrid)
        assert restarted.latched(OccupancyGrid) is not None


def test_messages_after_the_last_checkpoint_are_neither_mapped_nor_counted(tmp_path: Path) -> None:
    killed = begun(EVERY_SCAN, tmp_path)
    drive(killed, 0, 104)  # the last sweep is that of number 99
    with ModuleHarness(Mapping, output_directory=tmp_path, restored=killed.checkpoint) as restarted:
        assert (restarted.module.scans, restarted.module.odometry_messages) == (20, 100)
        assert len(restarted.module.mapper.trajectory()) == 100


def test_lasers_mounting_pose_stays_that_of_the_first_scan(tmp_path: Path) -> None:
    killed = begun(EVERY_SCAN, tmp_path)
    mount = Transform(translation=Vector3(x=0.2), rotation=Quaternion.from_yaw(0.3))
    mounted = TFMessage(transforms=[TransformStamped(child_frame_id="laser", transform=mount)])
    killed.send(mounted, topic="tf_static")
    drive(killed, 0, 50)
    with ModuleHarness(Mapping, output_directory=tmp_path, restored=killed.checkpoint) as restarted:
        assert restarted.module.mapper.laser_pose == pytest.approx([0.2, 0.0, 0.3])


def test_map_with_another_resolution_is_not_continued(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    killed = begun(EVERY_SCAN, tmp_path)
    drive(killed, 0, 50)
    with ModuleHarness(
        Mapping, {"resolution_m": 0.1}, output_directory=tmp_path, restored=killed.checkpoint
    ) as restarted:
        assert restarted.module.scans == 0
        assert "settings have changed" in caplog.text


def test_mapping_continues_when_its_map_is_too_large_for_a_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(_state: object) -> bool:
        raise CheckpointTooLarge("too large")

    with ModuleHarness(Mapping, EVERY_SCAN, output_directory=tmp_path) as harness:
        monkeypatch.setattr(harness.module, "checkpoint", refuse)
        drive(harness, 0, 50)
        assert harness.module.scans == 10
    assert caplog.text.count("a restart would lose") == 1


def command(linear_m_per_s: float) -> DriveCommand:
    return DriveCommand(linear_m_per_s=linear_m_per_s, valid_for=Duration(sec=1))


def test_restarted_base_finds_the_robot_where_it_is() -> None:
    with ModuleHarness(SimulatedBase, {"arena": str(ARENA)}) as base:
        for _ in range(4):
            for _ in range(5):
                base.send(fresh(base, command(0.4)))
                base.advance(0.1)
        wheels, truth = base.take(Odometry, "odom")[-1], base.take(Odometry, "ground_truth")[-1]
        state = base.checkpoint
    assert truth.pose.pose.position.x > 0.4
    with ModuleHarness(SimulatedBase, {"arena": str(ARENA)}, restored=state) as restarted:
        restarted.advance(0.0)
        assert restarted.take(Odometry, "odom")[-1].pose == wheels.pose
        again = restarted.take(Odometry, "ground_truth")[-1]
        assert again.pose == truth.pose
        assert again.twist.twist.linear.x == 0.0
        restarted.send(command(0.4))
        restarted.advance(1.0)
        assert restarted.take(Odometry, "ground_truth")[-1].pose.pose.position.x > again.pose.pose.position.x


def see(harness: ModuleHarness[Exploration], x_m: float, known_m: float = 5.0) -> None:
    """A room of 5 m around the origin with a known part, and the robot in it."""
    info = MapMetaData(resolution=0.05, width=100, height=100, origin=pose(-2.5, -2.5, 0.0))
    cells = np.full((100, 100), -1, np.int8)
    cells[: round(known_m / 0.05)] = 0
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    scan = LaserScan(
        angle_min=-2.0,
        angle_max=2.0,
        angle_increment=0.1,
        range_min=0.1,
        range_max=10.0,
        ranges=np.full(41, 2.0, np.float32),
    )
    harness.send(scan)
    harness.send(OccupancyGrid(info=info, data=cells.ravel()))
    harness.send(PoseStamped(pose=pose(x_m, 0.0, 0.0)), topic="map_pose")


def test_restarted_exploration_still_knows_home_and_its_time() -> None:
    settings = {"time_limit_s": 10.0}
    with ModuleHarness(Exploration, settings) as exploration:
        for _ in range(50):
            see(exploration, 0.5, known_m=3.0)
            exploration.advance(0.06)
        state = exploration.checkpoint
    assert state["home_xy_m"].tolist() == [0.5, 0.0]
    assert state["used_s"] == pytest.approx(3.0, abs=0.2)
    with ModuleHarness(Exploration, settings, restored=state) as restarted:
        see(restarted, 1.5)
        assert present(present(restarted.module.explorer).home_xy_m).tolist() == [0.5, 0.0]
        assert present(restarted.module.explorer).settings.time_limit_s == pytest.approx(7.0, abs=0.2)
        restarted.advance(0.06)
        assert restarted.checkpoint["used_s"] > state["used_s"]


def test_restarted_exploration_still_drives_home() -> None:
    with ModuleHarness(Exploration) as exploration:
        for _ in range(30):
            see(exploration, 0.5)
            exploration.advance(0.06)
        state = exploration.checkpoint
    assert state["exploring_ended"]
    with ModuleHarness(Exploration, restored=state) as restarted:
        for _ in range(3):
            see(restarted, 1.5)
            restarted.advance(0.06)
        assert present(restarted.module.explorer).state == "driving home"
