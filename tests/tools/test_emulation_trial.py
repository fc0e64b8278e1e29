"""The comparison of simulated and emulated robots: equal robots, the ground truth, and the pairs."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import LaserScan
from robbie_robots.hw.emulation.create import COUNTS_PER_M, MAX_SPEED_MM_PER_S, WHEEL_BASE_M
from robbie_robots.hw.simulation.differential_drive import CREATE_2
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.devices.emulated import EmulatedHokuyoLaser
from robbie_robots.modules.devices.hokuyo import HokuyoLaserRangeFinder
from robbie_robots.modules.devices.laser import SimulatedLaserRangeFinder
from tests.modules.devices.test_simulated_devices import ARENA, drive, tell
from tools.trials.devices.emulation import (
    LASER_TWIN,
    MERGE,
    MISSIONS,
    RANGE_MAX_M,
    Outcome,
    pose_errors,
    report,
    settings_of,
)

LIMIT_S = 30.0
SAME = Outcome("demo", "simulated", 0, 0.9, 0.01, 0.02, 0.05, 0.3, 0.04, 0, 2, 40.0, 1.0)


def test_twin_of_the_emulated_laser_publishes_the_same_beams(tmp_path: Path) -> None:
    (tmp_path / "arena.yaml").write_text(ARENA)
    arena: dict[str, object] = {"arena": tmp_path / "arena.yaml", "noise_m": 0.0}
    twin = {name.removeprefix("laser."): value for name, value in LASER_TWIN.items()}
    emulated = arena | {"range_max_m": RANGE_MAX_M}
    port: dict[str, object] = {"port": "run:laser_emulator", "merge": MERGE}
    with (
        ModuleHarness(SimulatedBase, {"arena": arena["arena"]}, name="base") as base,
        ModuleHarness(SimulatedLaserRangeFinder, arena | twin, name="laser") as simulated,
        ModuleHarness(
            EmulatedHokuyoLaser, emulated, name="laser_emulator", output_directory=tmp_path
        ) as laser_emulator,
        ModuleHarness(HokuyoLaserRangeFinder, port, name="laser", output_directory=tmp_path) as driver,
    ):
        drive(base, 0.3, 0.0)
        tell(base, simulated, laser_emulator)
        # Its line follows the machine's clock. By that, the base is so late that no sweep waits for it.
        laser_emulator.advance(time.monotonic() + LIMIT_S - laser_emulator.clock.monotonic_ns() / 1e9)
        simulated.advance(0.1)
        scans: list[LaserScan] = []
        give_up_s = time.monotonic() + LIMIT_S
        while not any(np.isfinite(scan.ranges).any() for scan in scans):
            assert time.monotonic() < give_up_s, driver.module.status
            driver.advance(0.005)
            scans += driver.take(LaserScan)
        one, other = simulated.take(LaserScan)[-1], scans[-1]
    assert len(one.ranges) == len(other.ranges) == 361
    assert (one.angle_min, one.angle_increment) == pytest.approx((other.angle_min, other.angle_increment))
    seen = np.isfinite(one.ranges) & np.isfinite(other.ranges)
    assert seen.sum() > 350
    # A few of the 1081 steps have no return, and another neighbour takes their place.
    assert (np.abs(one.ranges[seen] - other.ranges[seen]) < 2e-3).mean() > 0.95


def test_twin_of_the_emulated_base_has_the_body_of_a_create() -> None:
    assert CREATE_2.axle_m == WHEEL_BASE_M
    assert CREATE_2.max_wheel_m_per_s == MAX_SPEED_MM_PER_S / 1000
    assert 1 / CREATE_2.tick_m == pytest.approx(COUNTS_PER_M, rel=1e-3)


def test_both_robots_of_a_pair_get_the_same_seed_and_arena() -> None:
    for mission in MISSIONS.values():
        for devices in ("simulated", "emulated"):
            words = settings_of(mission, devices, 7, Path("arena.yaml"))
            of = {word.split("=")[0].split(".")[0] for word in words if ".seed=7" in word}
            suffix = "_emulator" if devices == "emulated" else ""
            assert {f"base{suffix}", f"laser{suffix}"} <= of
            assert f"base{suffix}.true_path=true" in words
            assert f"laser{suffix}.arena=arena.yaml" in words


def test_pose_errors_are_those_at_the_stamps_of_the_estimate() -> None:
    truth = np.array([[0.0, 0.0, 0.0, 3.1], [1.0, 1.0, 0.0, -3.1]])
    middle = (3.1 + (2 * math.pi - 3.1)) / 2
    estimated = np.array([[0.5, 0.5, 0.2, middle], [0.25, 0.25, 0.0, 3.1], [2.0, 9.0, 9.0, 0.0]])
    away_m, turned_rad = pose_errors(estimated, truth)
    assert away_m == pytest.approx([0.2, 0.0])
    assert turned_rad == pytest.approx([0.0, (2 * math.pi - 6.2) / 4])


def test_report_tells_a_difference_and_what_is_alike() -> None:
    runs = []
    for seed in range(8):
        noise_s = 0.1 * (-1) ** seed
        runs.append(replace(SAME, seed=seed))
        runs.append(replace(SAME, seed=seed, devices="emulated", mapped=0.8, duration_s=40.0 + noise_s))
    lines = {line.split(":")[0].strip(): line for line in report(runs).splitlines()}
    assert "p = 0.008" in lines["reachable area on the map"]
    assert "-0.1 [-0.1, -0.1]" in lines["reachable area on the map"]
    assert "p = 1.000" in lines["time of the mission, s"]


def test_report_leaves_out_runs_without_a_partner() -> None:
    runs = [SAME, replace(SAME, seed=1), replace(SAME, seed=1, devices="emulated")]
    assert report(runs).startswith("demo, 1 pairs")
