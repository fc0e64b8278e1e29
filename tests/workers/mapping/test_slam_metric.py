"""The metric agrees with manual computations, and with the published figures for the Intel log."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from robbie_mp.logs.recording.carmen import CarmenLog
from robbie_mp.logs.recording.carmen_records import LaserRecord
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.grid_mapper import GridMapper
from robbie_robots.workers.mapping.slam_metric import BadInput, main, measure, read_table
from tests._support.places import PROJECT

DATA = PROJECT.parent / "shared/data"
needs_intel = pytest.mark.skipif(not DATA.exists(), reason=f"the Intel log is not in {DATA}")
STRAIGHT = np.array([[10, 0, 0, 0], [11, 1, 0, 0], [12, 2, 0, 0], [13, 2, 0, math.pi / 2]], float)


def relation(first_s: float, second_s: float, x_m: float, y_m: float, yaw_rad: float) -> list[float]:
    return [first_s, second_s, x_m, y_m, 0, 0, 0, yaw_rad]


def test_trajectory_that_agrees_has_no_error() -> None:
    relations = np.array([relation(10, 12, 2, 0, 0), relation(13, 11, 0, 1, -math.pi / 2)])
    score = measure(STRAIGHT, relations)
    assert score.translation_mean_m == pytest.approx(0, abs=1e-12)
    assert score.rotation_mean_deg == pytest.approx(0, abs=1e-12)
    assert (score.relations_used, score.relations_unmatched) == (2, 0)


def test_errors_are_the_mean_and_deviation_of_absolute_differences() -> None:
    # The trajectory has (1, 0, 0) and (2, 0, 0): off by (0.3, 0.4) m and 10 degrees, by 1.5 m and 30 degrees.
    relations = np.array(
        [relation(10, 11, 0.7, -0.4, math.radians(10)), relation(10, 12, 3.5, 0, math.radians(-30))]
    )
    score = measure(STRAIGHT, relations)
    assert score.translation_mean_m == pytest.approx(1.0)
    assert score.translation_sd_m == pytest.approx(0.5)
    assert score.rotation_mean_deg == pytest.approx(20)
    assert score.rotation_sd_deg == pytest.approx(10)


def test_frame_of_the_trajectory_does_not_matter() -> None:
    relations = np.array([relation(10, 12, 1.8, 0.1, 0.2), relation(13, 11, 0.2, 1, -1)])
    turned = STRAIGHT.copy()
    turned[:, 1:3] = STRAIGHT[:, 1:3] @ [[0, 1], [-1, 0]] + [100, -50]
    turned[:, 3] += math.pi / 2
    first, second = measure(turned, relations), measure(STRAIGHT, relations)
    assert first.translation_mean_m == pytest.approx(second.translation_mean_m)
    assert first.rotation_mean_deg == pytest.approx(second.rotation_mean_deg)


def test_poses_are_interpolated_and_headings_take_the_short_way() -> None:
    trajectory = np.array([[0, 0, 0, 3.1], [0.04, 4, 0, -3.1]])
    score = measure(
        trajectory, np.array([relation(0, 0.01, -math.cos(3.1 - math.pi), 0, (2 * math.pi - 6.2) / 4)])
    )
    assert score.rotation_mean_deg == pytest.approx(0, abs=1e-9)
    assert score.translation_mean_m < 0.05


def test_order_of_the_stamps_does_not_matter() -> None:
    relations = np.array([relation(10, 12, 1.8, 0.1, 0.2), relation(13, 11, 0.2, 1, -1)])
    assert measure(STRAIGHT[[2, 0, 3, 1]], relations) == measure(STRAIGHT, relations)


def test_relations_without_a_pose_are_skipped_and_counted() -> None:
    relations = np.array([relation(10, 11, 1, 0, 0), relation(10, 11.5, 1, 0, 0), relation(9, 99, 1, 0, 0)])
    score = measure(STRAIGHT, relations)
    assert (score.relations_used, score.relations_unmatched) == (1, 2)
    with pytest.raises(BadInput, match="same drive"):
        measure(STRAIGHT, relations[2:])


def files(tmp_path: Path, trajectory: str, relations: str = "10 11 1 0 0 0 0 0\n") -> list[str]:
    (tmp_path / "trajectory.txt").write_text(trajectory)
    (tmp_path / "relations").write_text(relations)
    return [str(tmp_path / "trajectory.txt"), str(tmp_path / "relations")]


def test_command_prints_the_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = files(
        tmp_path, "# t x y theta\n10 0 0 0\n11 1.5 0 0\n", "10 11 1 0 0 0 0 0\n10 99 1 0 0 0 0 0\n"
    )
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert "0.500 ± 0.000 m" in out
    assert "1 used, 1 without a pose" in out
    assert "WARNING: left out 1 relations" in err
    assert main([*arguments, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["translation_mean_m"] == pytest.approx(0.5)
    assert printed["relations_unmatched"] == 1


@pytest.mark.parametrize(
    ("trajectory", "relations", "what"),
    [
        (
            "10 0 0 0\n11 1 x 0\n",
            "10 11 1 0 0 0 0 0\n",
            "trajectory.txt:2: could not convert string to float",
        ),
        ("10 0 0 0\n\n11 1 0\n", "10 11 1 0 0 0 0 0\n", "trajectory.txt:3: expected 4 finite numbers"),
        ("10 0 0 inf\n", "10 11 1 0 0 0 0 0\n", "trajectory.txt:1: expected 4 finite numbers"),
        ("# nothing\n", "10 11 1 0 0 0 0 0\n", "trajectory.txt: has no lines"),
        ("10 0 0 0\n", "10 11 1 0 0\n", "relations:1: expected 8 finite numbers"),
        ("10 0 0 0\n", "90 91 1 0 0 0 0 0\n", "are these the same drive?"),
    ],
)
def test_bad_input_ends_with_2_and_names_the_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], trajectory: str, relations: str, what: str
) -> None:
    assert main(files(tmp_path, trajectory, relations)) == 2
    assert what in capsys.readouterr().err


def test_missing_file_ends_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "none"), str(tmp_path / "none")]) == 2
    assert "cannot be read" in capsys.readouterr().err


@needs_intel
def test_raw_odometry_on_intel_has_the_known_error() -> None:
    odometry = [
        record for record in CarmenLog(DATA / "intel.clf").drive() if not isinstance(record, LaserRecord)
    ]
    trajectory = np.array([[each.ipc_time_s, each.x_m, each.y_m, each.theta_rad] for each in odometry])
    score = measure(trajectory, read_table(DATA / "intel.relations", 8, "relations"))
    assert score.translation_mean_m == pytest.approx(7.39, abs=0.01)
    assert (score.relations_used, score.relations_unmatched) == (2984, 0)


@needs_intel
@pytest.mark.parametrize(("every", "most", "error_m"), [(1, 330, 0.06), (2, 330, 0.04), (4, 150, 0.1)])
def test_mapper_is_accurate_on_the_first_lap_of_intel(every: int, most: int, error_m: float) -> None:
    """With every fourth beam, it was 1.5 m off after 150 sweeps: its matches confirmed odometry."""
    mapper, sweeps = GridMapper(), 0
    for record in CarmenLog(DATA / "intel.clf").drive():
        if isinstance(record, LaserRecord):
            sweeps += 1
            ranges_m, step_rad = np.array(record.ranges_m)[::every], every * record.angle_increment_rad
            sweep = LaserSweep.from_ranges(ranges_m, record.angle_min_rad, step_rad, 0.02, 80.0)
            mapper.add_scan(record.ipc_time_s, sweep)
        else:
            mapper.add_odometry(record.ipc_time_s, (record.x_m, record.y_m, record.theta_rad))
        if sweeps == most:
            break
    relations = read_table(DATA / "intel.relations", 8, "relations")
    odometry = mapper.state()["odometry"]["rows"]
    score, by_odometry = measure(mapper.trajectory(), relations), measure(odometry, relations)
    assert score.relations_used > most
    assert by_odometry.translation_mean_m > 0.3
    assert score.translation_mean_m < error_m
    assert score.rotation_mean_deg < 2.5
