"""The modules of real bases publish what the base tells, and nothing while it is away."""

import math
import os
import tty
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from robbie_mp import Duration, ModuleHarness
from robbie_mp.messages import (
    BatteryState,
    Bumper,
    ControlState,
    DeviceState,
    DriveCommand,
    EmergencyStop,
    Odometry,
)
from robbie_robots.hw.irobot import open_interface as oi
from robbie_robots.modules.devices.connected_base import CreateModule
from tests._support.commands import fresh
from tests.hw.irobot.test_create import frame

FORWARD = DriveCommand(linear_m_per_s=0.2, valid_for=Duration.from_seconds(0.3))


@dataclass
class Robot:
    """The module, and the robot's end of its line."""

    harness: ModuleHarness[CreateModule]
    line: int

    def send(self, data: bytes) -> None:
        os.write(self.line, data)
        self.harness.advance(0.02)

    def heard(self) -> bytes:
        return os.read(self.line, 4096)


@pytest.fixture
def robot() -> Iterator[Robot]:
    line, host = os.openpty()
    tty.setraw(host)
    try:
        with ModuleHarness(CreateModule, {"port": os.ttyname(host), "starts_in_auto": True}) as harness:
            harness.advance(0.02)
            yield Robot(harness, line)
    finally:
        os.close(host)
        os.close(line)


def test_frame_is_published_as_odometry_bumper_and_battery(robot: Robot) -> None:
    robot.send(frame() + frame(left_encoder=1000, right_encoder=1000, bumps_and_wheel_drops=1))
    _, odometry = robot.harness.take(Odometry)
    assert odometry.pose.pose.position.x == pytest.approx(1000 * math.pi * 0.072 / 508.8)
    assert odometry.pose.covariance[0] > 0
    assert [bumper.pressed for bumper in robot.harness.take(Bumper)] == [[], ["front_right"]]
    (battery,) = robot.harness.take(BatteryState)
    assert math.isnan(battery.percentage)


def test_command_drives_the_robot_and_emergency_stop_stops_it(robot: Robot) -> None:
    robot.send(frame())
    robot.heard()
    robot.harness.send(fresh(robot.harness, FORWARD))
    assert robot.heard() == oi.drive_direct(200, 200)
    robot.harness.send(EmergencyStop(engaged=True, reason="test"), topic="emergency_stop")
    assert robot.heard() == oi.drive_direct(0, 0)
    assert robot.harness.take(EmergencyStop)[-1].engaged
    robot.harness.send(EmergencyStop(engaged=False, reason="test"), topic="emergency_stop")
    assert not robot.harness.take(EmergencyStop)[-1].engaged


def test_disconnected_robot_is_told_and_nothing_else_is_published(robot: Robot) -> None:
    robot.send(frame())
    robot.harness.take(Odometry)
    robot.harness.take(DeviceState)
    # The port breaks at the next look: the silence is longer than allowed.
    robot.harness.module.device.silence_s = 0.0
    robot.harness.advance(0.1)
    state = robot.harness.take(DeviceState)[-1]
    assert (state.state, state.losses) == ("DISCONNECTED", 1)
    assert robot.harness.module.degraded.startswith("the device is disconnected: ")
    assert robot.harness.take(Odometry) == []


def test_base_that_is_not_there_tells_modules_that_start_that_it_is_stopped(robot: Robot) -> None:
    robot.harness.send(EmergencyStop(engaged=True, reason="test"), topic="emergency_stop")
    robot.harness.module.device.silence_s = 0.0
    robot.harness.advance(0.1)
    robot.harness.take(EmergencyStop)
    robot.harness.advance(0.25)
    assert robot.harness.take(EmergencyStop, "emergency_stop_state")[-1].engaged


def test_real_robot_does_not_follow_the_commands_of_a_log_that_is_played(robot: Robot) -> None:
    assert not CreateModule.follows_run_clock, "the commands would be as fresh as when they were recorded"
    robot.harness.advance(4.0)
    robot.harness.send(fresh(robot.harness, FORWARD, age_s=3.0), topic="manual")
    assert "1 too old" in robot.harness.module.control_status


def test_real_robot_holds_at_the_start_until_it_is_ordered_to_go_on() -> None:
    line, host = os.openpty()
    try:
        tty.setraw(host)
        with ModuleHarness(CreateModule, {"port": os.ttyname(host)}) as harness:
            harness.advance(0.02)
            harness.send(fresh(harness, FORWARD))
            state = harness.latched(ControlState, "control")
            assert state is not None and state.mode == ControlState.HOLD
            assert "1 not in control" in harness.module.control_status
    finally:
        os.close(host)
        os.close(line)
