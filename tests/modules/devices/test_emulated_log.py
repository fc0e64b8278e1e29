"""A log's odometry and scans arrive at the drivers of serial devices as bytes."""

import math
import time
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import LaserScan, Odometry
from robbie_robots.modules.devices.connected_base import CreateModule
from robbie_robots.modules.devices.emulated_log import EmulatedLog
from robbie_robots.modules.devices.sick_lms2xx import SickLms2xxRangeFinder

LIMIT_S = 60.0
BEAMS = 180
SCANS = 5
STEP_M, TURN_RAD = 0.04, 0.02


def ranges_of(scan: int) -> list[float]:
    """Ranges that tell which scan it is; the last beam has no return."""
    return [round(2.0 + scan + 0.01 * beam, 2) for beam in range(BEAMS - 1)] + [81.83]


def write_log(path: Path) -> tuple[float, float, float]:
    """Write a log of a drive along an arc; return its last pose."""
    x, y, heading = 0.0, 0.0, 0.0
    lines = []
    for step in range(10 * SCANS):
        stamp = f"{1e9 + 0.1 * step:.3f} host {0.1 * step:.3f}"
        lines.append(f"ODOM {x:.6f} {y:.6f} {heading:.6f} 0.4 0.2 0 {stamp}")
        if step % 10 == 5:
            pose = f"{x:.6f} {y:.6f} {heading:.6f}"
            ranges = " ".join(map(str, ranges_of(step // 10)))
            lines.append(f"FLASER {BEAMS} {ranges} {pose} {pose} {stamp}")
        last = (x, y, heading)
        x += STEP_M * math.cos(heading + TURN_RAD / 2)
        y += STEP_M * math.sin(heading + TURN_RAD / 2)
        heading += TURN_RAD
    path.write_text("\n".join(lines) + "\n")
    return last


@pytest.mark.slow
@pytest.mark.timeout(90)
def test_drivers_read_the_recorded_drive_from_their_ports(tmp_path: Path) -> None:
    last = write_log(tmp_path / "log.clf")
    laser_settings: dict[str, object] = {
        "port": "run:playback_laser",
        "resolution_deg": 1.0,
        "range_max_m": 80.0,
    }
    scans: list[LaserScan] = []
    odometry: list[Odometry] = []
    with (
        ModuleHarness(
            EmulatedLog,
            {"file": tmp_path / "log.clf", "rate": 4.0},
            name="playback",
            output_directory=tmp_path,
        ) as playback,
        ModuleHarness(
            CreateModule, {"port": "run:playback_base"}, name="base", output_directory=tmp_path
        ) as base,
        ModuleHarness(
            SickLms2xxRangeFinder, laser_settings, name="laser", output_directory=tmp_path
        ) as laser,
    ):
        give_up_s = time.monotonic() + LIMIT_S
        while not playback.module.stop_requested:
            assert time.monotonic() < give_up_s, playback.module.status
            base.advance(0.005)
            laser.advance(0.005)
            playback.advance(0.1)
            scans += [scan for scan in laser.take(LaserScan) if np.isfinite(scan.ranges).any()]
            odometry += base.take(Odometry, "odom")
    assert len(scans) == SCANS
    for number, scan in enumerate(scans):
        assert scan.ranges[: BEAMS - 1] == pytest.approx(ranges_of(number)[:-1], abs=1e-3)
        assert np.isinf(scan.ranges[BEAMS - 1 :]).all()
    there = odometry[-1].pose.pose
    assert math.dist((there.position.x, there.position.y), last[:2]) < 0.01
    assert there.orientation.yaw == pytest.approx(last[2], abs=0.01)
    played = np.loadtxt(tmp_path / "played.txt")
    assert len(played) == 10 * SCANS
    assert played[:, 1] == pytest.approx(1e9 + 0.1 * np.arange(10 * SCANS))
    assert (np.diff(played[:, 0]) > 0.0).all()
