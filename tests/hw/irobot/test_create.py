"""The driver of the Create 2."""

import math
import struct
from typing import Any

import pytest

from robbie_robots.hw.connection.device import ConnectionState
from robbie_robots.hw.drive import DriveCommandError
from robbie_robots.hw.irobot import open_interface as oi
from robbie_robots.hw.irobot.create import STREAM, CreateBase
from tests.hw._support.line import Clock, ScriptedDevice

HALT = oi.drive_direct(0, 0)
# Half a turn of a wheel.
HALF_TURN_COUNTS = 254.4


def frame(**values: int) -> bytes:
    """Return a frame of the stream; what is not told is 0, in safe mode."""
    values = {"mode": oi.CreateMode.SAFE, **values}
    data = b""
    for number in STREAM:
        (packet,) = oi.packets_of(number)
        data += bytes([number]) + struct.pack(">" + packet.format, values.pop(packet.name, 0))
    assert not values
    sent = bytes([oi.STREAM_HEADER, len(data)]) + data
    return sent + bytes([oi.checksum(sent)])


class Robot:
    """A driver and its scripted robot."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.device = ScriptedDevice()
        self.base = CreateBase(
            "scripted",
            clock=self.clock,
            monotonic=self.clock,
            open_port=lambda url, rate: self.device,  # type: ignore[arg-type, return-value]
        )
        self.base.poll()
        self.started = self.device.taken()


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_robot_is_started_in_safe_mode_with_its_stream_and_stands(robot: Robot) -> None:
    assert robot.base.state is ConnectionState.CONNECTED
    assert robot.started == oi.start() + oi.pause_stream() + oi.safe() + oi.stream(STREAM) + HALT


def test_frame_yields_bumpers_battery_and_problems(robot: Robot) -> None:
    robot.device.send(
        frame(
            bumps_and_wheel_drops=0b0110,
            cliff_right=1,
            voltage_mv=14400,
            current_ma=-500,
            charge_mah=2000,
            capacity_mah=2500,
        )
    )
    (reading,) = robot.base.poll()
    assert reading.pressed == ("front_left",)
    assert reading.problems == ("cliff on the right", "right wheel dropped")
    assert reading.battery is not None
    assert (reading.battery.voltage_v, reading.battery.current_a) == (14.4, 0.5)
    assert (reading.battery.charge_ah, reading.battery.capacity_ah) == (2.0, 2.5)
    assert reading.charging is False


def test_encoders_yield_the_way_over_their_wrap(robot: Robot) -> None:
    for left, right in ((65_500, 65_500), (200, 200)):
        robot.clock.now_s += 0.015
        robot.device.send(frame(left_encoder=left, right_encoder=right))
        (reading,) = robot.base.poll()
    assert reading.state.pose.x_m == pytest.approx(236 * math.pi * 0.072 / 508.8)
    assert reading.state.linear_m_per_s == pytest.approx(reading.state.pose.x_m / 0.015)
    assert reading.covariance[0, 0] > 0


def test_right_wheel_ahead_turns_left(robot: Robot) -> None:
    robot.device.send(frame() + frame(left_encoder=65_436, right_encoder=100))
    *_, reading = robot.base.poll()
    assert reading.state.pose.heading_rad == pytest.approx(200 * math.pi * 0.072 / 508.8 / 0.235)


def test_encoders_that_leap_are_no_motion(robot: Robot) -> None:
    robot.device.send(frame(left_encoder=30_000, right_encoder=30_000) + frame())
    *_, reading = robot.base.poll()
    assert reading.state.pose.x_m == 0.0


def test_command_turns_the_wheels_and_expires(robot: Robot) -> None:
    robot.device.send(frame())
    robot.base.poll()
    robot.base.command(0.2, 0.8, 0.3)
    assert robot.device.taken() == oi.drive_direct(left_mm_per_s=106, right_mm_per_s=294)
    robot.clock.now_s += 0.29
    robot.base.poll()
    assert robot.device.taken() == b""
    robot.clock.now_s += 0.02
    robot.base.poll()
    assert robot.device.taken() == HALT
    assert robot.base.expired_commands == 1


@pytest.mark.parametrize(
    ("step", "sent"),
    [("_motion", HALT), ("send", oi.drive_direct(200, 200) + HALT)],
    ids=["before the write", "in the write"],
)
def test_driver_that_is_stopped_in_a_command_until_it_has_expired_stops_the_robot_at_once(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, step: str, sent: bytes
) -> None:
    take = getattr(robot.base, step)

    def take_late(*arguments: Any) -> Any:
        robot.clock.now_s += 0.4
        return take(*arguments)

    monkeypatch.setattr(robot.base, step, take_late)
    robot.base.command(0.2, 0.0, 0.3)
    assert robot.device.taken() == sent
    assert robot.base.expired_commands == 1


def test_fast_command_keeps_its_curve(robot: Robot) -> None:
    robot.device.send(frame())
    robot.base.poll()
    robot.base.command(0.5, 2.0, 0.3)
    _, right, left = struct.unpack(">Bhh", robot.device.taken())
    assert right == 500
    assert (right + left) / (right - left) * 0.235 / 2 == pytest.approx(0.25, abs=0.002)


def test_passive_robot_is_made_safe_again_by_the_next_command(robot: Robot) -> None:
    robot.device.send(frame(mode=oi.CreateMode.PASSIVE, cliff_left=1))
    (reading,) = robot.base.poll()
    assert reading.problems == ("cliff on the left", "passive mode")
    robot.base.command(-0.1, 0.0, 0.3)
    assert robot.device.taken() == oi.safe() + oi.drive_direct(-100, -100)


def test_emergency_stop_latches(robot: Robot) -> None:
    robot.base.stop_for_emergency()
    assert robot.device.taken() == HALT
    robot.base.command(0.2, 0.0, 0.3)
    assert robot.device.taken() == b""
    assert robot.base.ignored_commands == 1
    robot.base.release()
    robot.device.send(frame())
    robot.base.poll()
    robot.base.command(0.2, 0.0, 0.3)
    assert robot.device.taken() == oi.drive_direct(200, 200)


def test_after_a_replug_the_robot_stands_until_the_next_command(robot: Robot) -> None:
    robot.base.command(0.2, 0.0, 10.0)
    robot.device.is_broken = True
    robot.base.poll()
    assert robot.base.reason == "pulled out"
    robot.base.command(0.2, 0.0, 10.0)
    robot.device = ScriptedDevice()
    robot.clock.now_s += 1.0
    robot.base.poll()
    assert robot.base.is_connected
    assert robot.device.taken() == robot.started
    robot.device.send(frame())
    robot.base.poll()
    assert robot.device.taken() == b""


def replugged(robot: Robot, left: int, right: int) -> tuple[float, float]:
    """Have the encoders go from 1000 to other counts while the cable is out; return the way and the turn."""
    robot.device.send(frame() + frame(left_encoder=1000, right_encoder=1000))
    *_, before = robot.base.poll()
    robot.device.is_broken = True
    robot.base.poll()
    robot.device = ScriptedDevice()
    robot.clock.now_s += 1.0
    robot.base.poll()
    robot.device.send(frame(left_encoder=left, right_encoder=right))
    (after,) = robot.base.poll()
    assert after.state.linear_m_per_s == 0.0
    then, now = before.state.pose, after.state.pose
    return now.x_m - then.x_m, now.heading_rad - then.heading_rad


def test_motion_without_a_cable_is_in_the_odometry(robot: Robot) -> None:
    way_m, turn_rad = replugged(robot, 1000 + 509, 1000 + 509)
    assert way_m == pytest.approx(math.pi * 0.072, rel=1e-3)
    assert turn_rad == 0.0


def test_pose_stays_if_the_robot_was_switched_off_and_on_while_the_cable_was_out(robot: Robot) -> None:
    assert replugged(robot, 0, 0) == (0.0, 0.0)


def test_silent_robot_counts_as_disconnected(robot: Robot) -> None:
    robot.clock.now_s += 0.6
    robot.base.poll()
    assert robot.base.state is ConnectionState.DISCONNECTED
    assert "nothing valid" in robot.base.reason


def test_command_that_is_no_number_is_refused(robot: Robot) -> None:
    with pytest.raises(DriveCommandError, match="linear_m_per_s"):
        robot.base.command(math.nan, 0.0, 1.0)


def test_closing_stops_robot_and_stream(robot: Robot) -> None:
    robot.base.close()
    assert robot.device.taken() == HALT + oi.pause_stream()
