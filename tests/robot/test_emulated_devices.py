"""The stock robots drive and map with the drivers of real hardware, on serial lines to emulated devices."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.workers.mapping.slam_metric import measure, read_table
from robbie_robots.workers.maps.map_file import read_map
from robbie_robots.workers.planar_pose import transform_points
from tests.robot._support.stock_robot import PROJECT, StockRobot
from tests.robot.test_stock_robot import DATA, INTEL, needs_intel

ARENAS = PROJECT / "hw" / "simulation" / "arenas"
ROOM = ARENAS / "rescue_small.yaml"
SEEN_FROM_START_M2 = 4.3
"""The robot's first sweeps show less than this of the small room."""


@pytest.mark.slow
@pytest.mark.timeout(360)
def test_bytes_of_serial_devices_become_a_map_of_the_arena_and_the_robot_comes_home(
    robot: StockRobot,
) -> None:
    in_room = [
        word
        for name in ("base_emulator", "laser_emulator", "imu_emulator", "camera")
        for word in ("--set", f"{name}.arena={ROOM}")
    ]
    code, modules, errors = robot.run(
        "rescue-emulated", *in_room, "--set", "mission.time_limit_s=150", timeout_s=300.0
    )
    assert code == 0, errors
    assert all(module["restarts"] == 0 for module in modules.values())
    for name in ("base", "laser", "imu"):
        assert f"the device at run:{name}_emulator is connected" in log_of(robot, name)
    emulated = {
        one["type_name"]
        for name in modules
        if name.endswith("_emulator")
        for one in modules[name]["publishes"]
    }
    assert emulated == {"nav_msgs/msg/Odometry"}
    assert [one["topic"] for one in modules["base_emulator"]["publishes"]] == ["ground_truth"]
    delivered = {
        (one["type_name"], one["topic"]): one["delivered"] for one in modules["mapping"]["subscriptions"]
    }
    assert delivered["sensor_msgs/msg/LaserScan", ""] > 15
    assert delivered["nav_msgs/msg/Odometry", "odom"] > 30
    assert modules["imu"]["published"] > 100
    mission = json.loads((robot.output / "mission.json").read_text())
    assert mission["mapped_m2"] > SEEN_FROM_START_M2
    assert mission["collisions"] == 0
    assert json.loads((robot.output / "base.json").read_text())["collisions"] == 0
    away_m = away_from_walls_m(read_arena(ROOM), robot.output / "map.yaml")
    assert len(away_m) > 100 and float(away_m.mean()) < 0.05
    assert not list((robot.output / "ports").iterdir())


def log_of(robot: StockRobot, module: str) -> str:
    """What a module has logged."""
    return (robot.output / "log" / f"{module}.jsonl").read_text()


def away_from_walls_m(arena: Arena, map_file: Path) -> NDArray[np.float64]:
    """Return the distance of each occupied cell of a map from the nearest true wall: (N,)."""
    made = read_map(map_file)
    rows, columns = np.nonzero(made.cells == 100)
    places = made.corner_xy_m + (np.stack([columns, rows], axis=1) + 0.5) * made.resolution_m
    return np.abs(arena.clearance_m(transform_points(np.array(arena.start), places)))


@needs_intel
@pytest.mark.slow
@pytest.mark.timeout(360)
def test_beginning_of_the_intel_log_is_mapped_through_serial_lines(robot: StockRobot, tmp_path: Path) -> None:
    part = tmp_path / "part.clf"
    part.write_text("".join(INTEL.read_text().splitlines(keepends=True)[:2000]))
    settings = ("--set", f"playback.file={part}", "--set", "playback.rate=6.0")
    code, _, errors = robot.run("intel-emulated", *settings, timeout_s=300.0)
    assert code in (0, 3), errors  # 3: a module is DEGRADED at the end, as on a busy machine
    played = json.loads((robot.output / "played.json").read_text())
    assert played["sent"] == played["scans"] > 10
    trajectory = read_table(robot.output / "trajectory.txt", 4, "t x y theta")
    relations = read_table(DATA / "intel.relations", 8, "t1 t2 and the pose of t2 seen from t1")
    score = measure(
        with_stamps_of_log(trajectory, read_table(robot.output / "played.txt", 2, "t stamp")), relations
    )
    assert score.relations_used > 10
    assert score.translation_mean_m < 0.25


def with_stamps_of_log(trajectory: NDArray[np.float64], played: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the poses of a played drive with the stamps of the log, a row for each odometry record: (N, 4).

    Args:
        trajectory: (M, 4) stamp (s), x, y (m), heading (rad), by the time of the run.
        played: (N, 2) when, by the time of the run, each record was played, and its own stamp, s. Those
            outside the trajectory are left out.
    """
    times_s = trajectory[:, 0]
    inside = played[(played[:, 0] >= times_s[0]) & (played[:, 0] <= times_s[-1])]
    columns = (trajectory[:, 1], trajectory[:, 2], np.unwrap(trajectory[:, 3]))
    poses = [np.interp(inside[:, 0], times_s, column) for column in columns]
    return np.column_stack([inside[:, 1], *poses])
