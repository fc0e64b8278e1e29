"""A robot that is lifted and put down elsewhere in a log is found again; a trial counts what went wrong."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.hw.simulation.random_rooms import drawn_map, random_rooms
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from tools.trials.__main__ import main
from tools.trials.driving import kidnap
from tools.trials.driving.kidnap import MOST_M, KidnapBuilding, run_trial
from tools.trials.driving.localization import CLEARANCE_M, RESOLUTION_M, STEP_S, Conditions, Operator
from tools.trials.driving.swept import swept

STEPS, STEPS_PER_SCAN = 1000, 8


def write_log(file: Path, seed: int, steps: int = STEPS) -> None:
    """Drive around in random rooms, and write what odometry and laser say, as CARMEN does."""
    now_s = 0.0
    arena = random_rooms(seed, 14.0, 10.0)
    laser = SimulatedLaser(arena, Conditions(view_deg=180.0).laser(), seed=seed)
    cells, corner = drawn_map(arena, RESOLUTION_M)
    grid = NavigationGrid(cells, RESOLUTION_M, corner, CLEARANCE_M)
    operator = Operator(grid, seed)
    drive = SimulatedDrive(arena, lambda: now_s, seed)
    lines = ["PARAM robot_frontlaser_offset 0.0 nohost 0"]
    for number in range(steps):
        truth, wheels = drive.ground_truth(), drive.read()
        laser.place(truth.pose, truth.stamp_s)
        ranges = laser.scan().ranges_m
        pose, end = " ".join(f"{value:.6f}" for value in wheels.pose), f"{now_s:.3f} nohost {now_s:.3f}"
        lines.append(f"ODOM {pose} 0 0 0 {end}")
        if number % STEPS_PER_SCAN == 0:
            beams = " ".join(f"{81.83 if math.isinf(value) else value:.3f}" for value in ranges.tolist())
            lines.append(f"FLASER {len(ranges)} {beams} {pose} {pose} {end}")
        drive.command(*operator.speeds(truth.pose, swept(laser)), valid_for_s=0.4)
        now_s += STEP_S
    file.write_text("\n".join(lines) + "\n")


def test_lifted_robot_is_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kidnap, "AFTER_M", 15.0)
    write_log(tmp_path / "rooms.clf", seed=2)
    building = KidnapBuilding(tmp_path / "rooms.clf")
    assert sum(step.scan is not None for step in building.steps) == pytest.approx(
        STEPS / STEPS_PER_SCAN, abs=2
    )
    trial = run_trial(building, 1, whole_map=True)
    assert trial.moved_m >= 5.0
    assert trial.found_m is not None
    assert trial.found_m < MOST_M
    assert trial.is_good
    assert trial.worst_after_m < 0.3
    assert not replace(trial, found_m=MOST_M + 1).is_good
    assert not replace(trial, found_m=None).is_good


def test_log_that_is_too_short_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_log(tmp_path / "short.clf", seed=2, steps=20)
    with pytest.raises(SystemExit):
        main(["kidnap", "--log", str(tmp_path / "short.clf")])
    assert "too short to lift the robot" in capsys.readouterr().err


def test_missing_log_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["kidnap", "--log", str(tmp_path / "none.clf")])
    assert "there is no log" in capsys.readouterr().err
