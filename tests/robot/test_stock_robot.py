"""The stock robot's profiles, run as a user runs them."""

import json
import os
import signal
import time
from pathlib import Path

import pytest
from PIL import Image

from robbie_robots.workers.mapping.slam_metric import measure, read_table
from tests.robot._support.stock_robot import PROJECT, StockRobot

DATA = PROJECT.parent / "shared" / "data"
INTEL = DATA / "intel.clf"

# Whole robots on a busy machine take their time.
pytestmark = [pytest.mark.alone, pytest.mark.timeout(150)]

needs_intel = pytest.mark.skipif(not INTEL.exists(), reason=f"the Intel log is not at {INTEL}")


@pytest.mark.every_turn
def test_demo_explores_maps_drives_home_and_touches_nothing(robot: StockRobot) -> None:
    code, modules, errors = robot.run("demo", "--set", "exploration.time_limit_s=7")
    assert code == 0, errors
    assert json.loads((robot.output / "base.json").read_text())["collisions"] == 0
    with Image.open(robot.output / "map.png") as picture:
        assert min(picture.size) > 300
    assert modules["mapping"]["handled"] > 100
    assert modules["mapping"]["lost"] == 0
    assert all(module["restarts"] == 0 for module in modules.values())


@needs_intel
@pytest.mark.timeout(450)
def test_intel_log_is_mapped_completely_and_better_than_by_scan_matching(robot: StockRobot) -> None:
    code, modules, errors = robot.run("intel", "--set", f"playback.file={INTEL}", timeout_s=400)
    assert code == 0, errors
    counted = json.loads((robot.output / "mapping.json").read_text())
    assert (counted["scans"], counted["odometry_messages"]) == (910, 14541)
    books = {(entry["type_name"], entry["topic"]): entry for entry in modules["mapping"]["subscriptions"]}
    assert books["sensor_msgs/msg/LaserScan", ""]["delivered"] == 910
    assert books["nav_msgs/msg/Odometry", "odom"]["delivered"] == 14541
    assert modules["mapping"]["dropped"] == modules["mapping"]["lost"] == modules["playback"]["refused"] == 0
    trajectory = read_table(robot.output / "trajectory.txt", 4, "t x y theta")
    score = measure(
        trajectory, read_table(DATA / "intel.relations", 8, "t1 t2 and the pose of t2 seen from t1")
    )
    assert (score.relations_used, score.relations_unmatched) == (2984, 0)
    assert score.translation_mean_m < 0.1


@needs_intel
@pytest.mark.timeout(300)
def test_only_the_killed_mapping_is_restarted_and_its_loss_is_counted(
    robot: StockRobot, tmp_path: Path
) -> None:
    part = tmp_path / "part.clf"
    part.write_text("".join(INTEL.read_text().splitlines(keepends=True)[:4000]))
    robot.start("intel", "--set", f"playback.file={part}")
    deadline = time.monotonic() + 120
    while not (figures := robot.top()) or figures["mapping"]["handled"] < 500:
        assert time.monotonic() < deadline, figures
    os.kill(figures["mapping"]["pid"], signal.SIGKILL)
    code, modules, errors = robot.wait(150)
    assert code == 0, errors
    assert modules["mapping"]["restarts"] == 1
    assert modules["playback"]["restarts"] == modules["core"]["restarts"] == 0
    assert modules["mapping"]["lost"] <= 1
    assert modules["mapping"]["dropped"] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing"], "there is no profile 'nothing'"),
        (["intel"], "CarmenPlayback.file: required"),
        (["intel", "--set", "playback.file=/no/such/log.clf"], "/no/such/log.clf"),
        (["intel", "--set", "playback.fiel=x"], "fiel"),
        (["demo", "--set", "mapping.resolution_m=wide"], "resolution_m"),
        (["demo", "--set", "base.period_s=-1"], "period_s"),
    ],
)
def test_bad_input_is_refused_before_any_process_starts(
    robot: StockRobot, arguments: list[str], said: str
) -> None:
    code, _, errors = robot.run(*arguments)
    assert code == 2
    assert said in errors
    assert "Traceback" not in errors
    assert not robot.output.exists()


def test_broken_line_of_a_log_is_left_out_and_counted(robot: StockRobot, tmp_path: Path) -> None:
    broken = tmp_path / "broken.clf"
    lines = [f"ODOM {i}.0 0 0 0 0 0 {1000 + i}.0 host {i}.0\n" for i in range(5)]
    lines[2] = "ODOM 1.0 what\n"
    broken.write_text("".join(lines))
    code, modules, errors = robot.run("intel", "--set", f"playback.file={broken}")
    assert code == 0, errors
    assert modules["mapping"]["handled"] == 5  # four lines and the place of the laser
    assert "broken ODOM lines; the first is line 3" in (robot.output / "log" / "playback.jsonl").read_text()
