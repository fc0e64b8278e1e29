"""Emulated bases and lasers: what they measure belongs to the time that they tell."""

import math
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import Header, ModuleHarness, Time
from robbie_mp.messages import Odometry, Point, Pose, PoseWithCovariance, Twist, TwistWithCovariance, Vector3
from robbie_robots.hw.emulation.body import SimulatedBody
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.simulation.differential_drive import CREATE_2
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.devices.emulated import (
    EmulatedCreateBase,
    EmulatedHokuyoLaser,
    EmulatedPioneerBase,
)
from tests.modules.devices.test_simulated_devices import ARENA, drive

SPEED_M_PER_S = 0.4
AHEAD = 540
"""The step of a UTM-30LX that looks straight ahead."""


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, object]:
    (tmp_path / "arena.yaml").write_text(ARENA)
    return {"arena": tmp_path / "arena.yaml"}


class HandMovedBase(EmulatedCreateBase):
    """A base that only the test moves, not its controller."""

    def create_device(self, body: SimulatedBody) -> EmulatedCreate:
        """Return a controller with another body."""
        self.create = EmulatedCreate()
        return self.create


def test_true_pose_has_the_time_at_which_the_robot_was_there(settings: dict[str, object]) -> None:
    truths = []
    # The simulated drive moves in steps of 10 ms; these times lie between them.
    with ModuleHarness(HandMovedBase, settings | {"period_s": 0.0233}, name="base_emulator") as base:
        base.module.body.move(SPEED_M_PER_S, 0.0, 0.0, base.clock.monotonic_ns() / 1e9)
        for _ in range(60):
            base.advance(0.0233)
            base.module.body.move(SPEED_M_PER_S, 0.0, 0.0, base.clock.monotonic_ns() / 1e9)
            truths += base.take(Odometry, "ground_truth")
    full_speed = [truth for truth in truths if truth.twist.twist.linear.x == SPEED_M_PER_S]
    times_s = np.array([truth.header.stamp.nanoseconds / 1e9 for truth in full_speed])
    ways_m = np.array([truth.pose.pose.position.x for truth in full_speed])
    assert len(times_s) > 10 and np.all(np.diff(times_s) > 0.0)
    assert np.diff(ways_m) / np.diff(times_s) == pytest.approx(SPEED_M_PER_S, rel=1e-3)


def truth(x_m: float, speed_m_per_s: float, at_ns: int) -> Odometry:
    """Return where the robot truly is."""
    return Odometry(
        header=Header(stamp=Time.from_nanoseconds(at_ns)),
        pose=PoseWithCovariance(pose=Pose(position=Point(x=x_m))),
        twist=TwistWithCovariance(twist=Twist(linear=Vector3(x=speed_m_per_s))),
    )


def test_laser_measures_from_where_the_robot_was_at_the_time_of_the_sweep(
    settings: dict[str, object],
) -> None:
    with ModuleHarness(EmulatedHokuyoLaser, settings | {"noise_m": 0.0}, name="laser_emulator") as laser:
        began_s = laser.clock.monotonic_ns() / 1e9
        # It brakes within the second: between both states it is where it truly was, not where it was heading.
        laser.send(truth(0.5, SPEED_M_PER_S, laser.clock.now_ns()), topic="ground_truth")
        laser.advance(1.0)
        laser.send(truth(0.7, 0.0, laser.clock.now_ns()), topic="ground_truth")
        laser.advance(0.5)
        ahead_m = [float(laser.module.measure(began_s + after_s)[AHEAD]) for after_s in (0.0, 0.5, 1.0, 1.5)]
    assert math.isfinite(ahead_m[0])
    assert [ahead_m[0] - each for each in ahead_m] == pytest.approx([0.0, 0.1, 0.2, 0.2], abs=1e-3)


def test_sweep_waits_until_the_robots_true_pose_is_known(settings: dict[str, object]) -> None:
    with ModuleHarness(EmulatedHokuyoLaser, settings, name="laser_emulator") as laser:
        assert laser.module.knows(0.0)  # it sees nothing before the base's first message
        laser.send(truth(0.5, SPEED_M_PER_S, laser.clock.now_ns()), topic="ground_truth")
        laser.advance(0.1)
        measured_s = laser.clock.monotonic_ns() / 1e9 - 0.05
        assert not laser.module.knows(measured_s)
        laser.send(truth(0.52, 0.0, laser.clock.now_ns()), topic="ground_truth")
        assert laser.module.knows(measured_s)
        # A base that has gone does not silence the laser.
        laser.advance(1.0)
        measured_s = laser.clock.monotonic_ns() / 1e9
        assert not laser.module.knows(measured_s)
        laser.advance(0.31)
        assert laser.module.knows(measured_s)


def test_laser_moves_on_with_the_robot_after_its_last_true_pose(settings: dict[str, object]) -> None:
    with ModuleHarness(EmulatedHokuyoLaser, settings | {"noise_m": 0.0}, name="laser_emulator") as laser:
        began_s = laser.clock.monotonic_ns() / 1e9
        laser.send(truth(0.5, SPEED_M_PER_S, laser.clock.now_ns()), topic="ground_truth")
        laser.advance(0.5)
        at_once_m, later_m = (float(laser.module.measure(began_s + after_s)[AHEAD]) for after_s in (0.0, 0.5))
    assert at_once_m - later_m == pytest.approx(SPEED_M_PER_S * 0.5, abs=1e-3)


def test_watchdog_of_the_emulated_pioneer_is_that_of_the_profile(settings: dict[str, object]) -> None:
    with ModuleHarness(EmulatedPioneerBase, settings | {"watchdog_s": 0.3}, name="base_emulator") as base:
        assert base.module.pioneer.base.watchdog_s == 0.3


def test_simulated_base_drives_with_the_body_of_a_create_and_writes_its_true_path(
    settings: dict[str, object], tmp_path: Path
) -> None:
    wanted = settings | {"body": "create", "true_path": True}
    with ModuleHarness(SimulatedBase, wanted, name="base", output_directory=tmp_path) as base:
        drive(base, 3.0, 0.8)
        truths = base.take(Odometry, "ground_truth")
    assert max(truth.twist.twist.linear.x for truth in truths) == CREATE_2.max_linear_m_per_s
    path = np.loadtxt(tmp_path / "truth.txt")
    assert len(path) == len(truths)
    last = truths[-1]
    assert path[-1] == pytest.approx(
        [last.header.stamp.nanoseconds / 1e9, last.pose.pose.position.x, 0.0, 0.0], abs=1e-5
    )
