"""An emulated base and laser repeat a recorded drive."""

import math

import numpy as np
import pytest

from robbie_robots.hw.emulation.recorded import MAX_M_PER_S, MAX_RAD_PER_S, RecordedBody, recorded_drive
from robbie_robots.hw.pose import ORIGIN, Pose

PERIOD_S = 0.1
SWEEP = np.ones(3, np.float32)


def arcs(count: int) -> tuple[list[float], list[Pose]]:
    """Stamps that jitter, up to being equal, and poses along arcs, forward and back."""
    chance = np.random.default_rng(3)
    stamps, poses = [0.0], [Pose(1.0, -2.0, 3.0)]
    for _ in range(count):
        stamps.append(stamps[-1] + max(0.0, chance.normal(0.1, 0.1)))
        poses.append(poses[-1].after_arc(chance.normal(0.03, 0.03), chance.normal(0.0, 0.1)))
    return stamps, poses


def test_body_drives_the_recorded_way_whatever_the_motors_are_told() -> None:
    stamps, poses = arcs(200)
    drive = recorded_drive(stamps, np.array(poses), [None] * len(poses), PERIOD_S)
    body = RecordedBody(drive, lambda: 5.0)
    assert body.move(1.0, 1.0, 0.02, 4.0) == (0.0, 0.0)
    here, visited = ORIGIN, {}
    times = np.unique(np.concatenate([drive.times_s, np.arange(0.0, drive.duration_s + 1.0, 0.015)]))
    for time_s in times:
        here = here.after_arc(*body.move(0.0, 0.0, 0.015, 5.0 + float(time_s)))
        visited[float(time_s)] = here
    for time_s, pose in zip(drive.times_s, poses, strict=True):
        there = poses[0].plus(visited[float(time_s)])
        assert math.dist(there[:2], pose[:2]) < 1e-6
        assert math.remainder(there.heading_rad - pose.heading_rad, 2 * math.pi) == pytest.approx(
            0.0, abs=1e-9
        )


def test_base_is_never_faster_than_its_limits_though_stamps_jitter() -> None:
    stamps, poses = arcs(300)
    drive = recorded_drive(stamps, np.array(poses), [None] * len(poses), PERIOD_S, rate=10.0)
    passed_s = np.diff(drive.times_s)
    assert (np.abs(np.diff(drive.ways_m)) <= MAX_M_PER_S * passed_s + 1e-9).all()
    assert (np.abs(np.diff(drive.turns_rad)) <= MAX_RAD_PER_S * passed_s + 1e-9).all()
    assert drive.duration_s < stamps[-1]


def test_each_sweep_is_seen_from_where_it_was_recorded() -> None:
    stamps, poses = arcs(100)
    sweeps = [SWEEP * index if index % 5 in (0, 1) else None for index in range(101)]
    drive = recorded_drive(stamps, np.array(poses), sweeps, PERIOD_S, rate=2.0)
    assert len(drive.sweeps) == sum(sweep is not None for sweep in sweeps)
    for number, sweep in drive.sweeps.items():
        index = int(sweep[0])
        assert drive.times_s[index] == pytest.approx(number * PERIOD_S)
    assert list(drive.sweeps) == sorted(drive.sweeps)
