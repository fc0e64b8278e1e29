"""The driver of Pioneer robots."""

import math
import struct

import pytest

from robbie_robots.hw.connection.device import ConnectionState
from robbie_robots.hw.pioneer import p2os
from robbie_robots.hw.pioneer.base import PioneerBase
from robbie_robots.hw.pioneer.p2os import PioneerCommand, command
from tests.hw._support.line import Clock, ScriptedDevice


def parameters(watchdog_ms: int = 150, report_ms: int = 100, brakes: tuple[int, int] = (300, 2000)) -> bytes:
    """Return a robot's answer to CONFIG: it may brake with 2 m/s^2 and 300 degrees/s^2."""
    body = b"\x20Pioneer\0p3at\0SN1\0" + struct.pack("<B5H", 4, 360, 1500, *brakes, 500) + b"Robbie\0"
    body += struct.pack("<BBBHHBHHHB4H", report_ms, 0, 0, 0, 1, 1, 110, 32550, watchdog_ms, 0, 1, 2, 3, 4)
    body += struct.pack("<HH5H5H", 100, 750, 100, 100, 40, 20, 0, 300, 300, 40, 30, 0)
    return p2os.packet(body + bytes(6))


HANDSHAKE = {
    command(PioneerCommand.PULSE): command(0),
    command(PioneerCommand.OPEN): command(1),
    command(PioneerCommand.CLOSE): p2os.packet(b"\x02Robbie\0Pioneer\0p3at-sh\0"),
    command(PioneerCommand.CONFIG): parameters(),
}


def sip(
    x: int = 0, y: int = 0, heading: int = 0, left: int = 0, right: int = 0, bits: tuple[int, int] = (0, 0)
) -> bytes:
    values = (x & 0x7FFF, y & 0x7FFF, heading, left, right, 124, *bits, 0, 1, 0)
    return p2os.packet(b"\x32" + struct.pack("<HHhhhBBBhHB", *values) + b"\x01" + struct.pack("<BH", 3, 1500))


class Robot:
    """A driver and its scripted robot."""

    def __init__(self, answers: dict[bytes, bytes] = HANDSHAKE, stands_within_s: float = 0.4) -> None:
        self.clock = Clock()
        self.device = ScriptedDevice(answers)
        # A port that has nothing to read takes time.
        self.device.wait = self.clock.pass_time
        self.base = PioneerBase(
            "scripted",
            stands_within_s=stands_within_s,
            clock=self.clock,
            monotonic=self.clock,
            open_port=lambda url, rate: self.device,  # type: ignore[arg-type, return-value]
        )
        self.base.poll()
        self.started = self.device.taken()


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_handshake_opens_the_robot_with_motors_and_sonars(robot: Robot) -> None:
    assert robot.base.state is ConnectionState.CONNECTED
    assert robot.base.name == ("Robbie", "Pioneer", "p3at-sh")
    assert robot.started.endswith(command(PioneerCommand.STOP))
    assert command(PioneerCommand.ENABLE, 1) in robot.started
    assert command(PioneerCommand.SONAR, 1) in robot.started


def test_robot_that_answers_wrongly_is_tried_again() -> None:
    answers = {**HANDSHAKE, command(PioneerCommand.CLOSE): p2os.packet(b"\x02")}
    robot = Robot(answers)
    assert robot.base.state is ConnectionState.DISCONNECTED
    assert "does not tell its name" in robot.base.reason
    robot.device.answers = HANDSHAKE
    robot.clock.now_s += 1.0
    robot.base.poll()
    assert robot.base.is_connected


def test_standard_packet_yields_sonars_bumpers_stalls_and_battery(robot: Robot) -> None:
    robot.device.send(sip(bits=(1, 0b10)))
    (reading,) = robot.base.poll()
    assert reading.sonar_m == {3: 1.5}
    assert reading.pressed == ("front_left", "front_right")
    assert reading.problems == ("left wheels stalled",)
    assert reading.battery is not None and reading.battery.voltage_v == 12.4


def test_sonar_that_sees_nothing_is_infinite(robot: Robot) -> None:
    data = b"\x32" + struct.pack("<HHhhhBBBhHB", *(0,) * 11) + b"\x01" + struct.pack("<BH", 7, 5000)
    robot.device.send(p2os.packet(data))
    *_, reading = robot.base.poll()
    assert reading.sonar_m == {7: math.inf}


def test_positions_yield_the_way_over_their_wrap(robot: Robot) -> None:
    robot.device.send(sip(x=32_700) + sip(x=100))
    *_, reading = robot.base.poll()
    assert reading.state.pose.x_m == pytest.approx(0.168)


def test_way_backwards_in_another_direction_is_negative(robot: Robot) -> None:
    # The robot looks along its y axis and drives back; in our frame it looks along x.
    robot.device.send(sip(heading=1024) + sip(y=-500, heading=1024))
    *_, reading = robot.base.poll()
    assert reading.state.pose.x_m == pytest.approx(-0.5)
    assert reading.state.pose.y_m == pytest.approx(0.0, abs=1e-9)


def test_restarted_controller_is_no_motion(robot: Robot) -> None:
    robot.device.send(sip(x=5000) + sip(x=0))
    *_, reading = robot.base.poll()
    assert reading.state.pose.x_m == 0.0


def replugged(robot: Robot, told: bytes) -> tuple[float, float]:
    """Have the robot report at (400, 0) mm, be lost, and report again; return the way and the turn."""
    robot.device.send(sip() + sip(x=400))
    *_, before = robot.base.poll()
    robot.device.is_broken = True
    robot.base.poll()
    robot.device = ScriptedDevice(HANDSHAKE)
    robot.device.wait = robot.clock.pass_time
    robot.clock.now_s += 1.0
    robot.base.poll()
    robot.device.send(told)
    (after,) = robot.base.poll()
    then, now = before.state.pose, after.state.pose
    return now.x_m - then.x_m, now.heading_rad - then.heading_rad


def test_motion_without_a_cable_is_in_the_odometry(robot: Robot) -> None:
    way_m, turn_rad = replugged(robot, sip(x=500, heading=64))
    assert way_m == pytest.approx(0.1, rel=0.01)
    assert turn_rad == pytest.approx(math.tau / 64)


def test_pose_stays_if_the_controller_was_restarted_while_the_cable_was_out(robot: Robot) -> None:
    assert replugged(robot, sip()) == (0.0, 0.0)


def test_wheel_speeds_yield_the_robots_speeds(robot: Robot) -> None:
    robot.device.send(sip(left=100, right=300))
    (reading,) = robot.base.poll()
    assert reading.state.linear_m_per_s == pytest.approx(0.2)
    assert reading.state.angular_rad_per_s == pytest.approx(0.34)


def test_command_is_sent_as_speed_and_turn_and_expires(robot: Robot) -> None:
    robot.base.command(-0.2, math.radians(30), 0.25)
    assert robot.device.taken() == command(PioneerCommand.SPEED, -200) + command(PioneerCommand.TURN_RATE, 30)
    robot.clock.now_s += 0.26
    robot.base.poll()
    assert robot.device.taken().endswith(command(PioneerCommand.STOP))
    assert robot.base.expired_commands == 1


def test_watchdog_is_kept_content(robot: Robot) -> None:
    robot.base.poll()
    robot.device.taken()
    pulses = 0
    for _ in range(100):
        robot.clock.now_s += 0.01
        robot.device.send(sip())
        robot.base.poll()
        pulses += robot.device.taken().count(command(PioneerCommand.PULSE))
    # Every 50 ms, or one poll later: three of four may be lost before a watchdog of 0.2 s bites.
    assert 16 <= pulses <= 21


def test_emergency_stop_is_the_robots_own(robot: Robot) -> None:
    robot.base.stop_for_emergency()
    assert robot.device.taken() == command(PioneerCommand.EMERGENCY_STOP) + command(PioneerCommand.STOP)


def test_closing_disables_the_motors(robot: Robot) -> None:
    robot.base.close()
    assert robot.device.taken().endswith(command(PioneerCommand.ENABLE, 0) + command(PioneerCommand.CLOSE))


def test_robot_brakes_as_hard_as_it_can_and_drives_no_faster_than_it_can_brake_from(robot: Robot) -> None:
    assert command(PioneerCommand.ACCELERATION, -2000) in robot.started
    assert command(PioneerCommand.TURN_ACCELERATION, -300) in robot.started
    # 0.15 s for the watchdog, 0.05 s for what is late, 0.2 s to brake.
    assert robot.base.limits.linear_m_per_s == pytest.approx(0.4)
    assert robot.base.limits.angular_rad_per_s == pytest.approx(math.radians(60))
    robot.base.command(0.8, 0.5, 0.3)
    assert robot.device.taken() == command(PioneerCommand.SPEED, 400) + command(PioneerCommand.TURN_RATE, 14)


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (parameters(watchdog_ms=2000), "brakes only 2 s after the loss of its line"),
        (parameters(watchdog_ms=0), "its watchdog is off: it drives on when it loses its line"),
        (parameters(brakes=(0, 2000)), "does not tell how hard it brakes"),
        (parameters(brakes=(300, 0)), "does not tell how hard it brakes"),
        (b"", "does not tell whether its watchdog stops it"),
        (p2os.packet(b"\x20Pioneer\0p3at\0SN1\0\x04"), "does not tell whether its watchdog stops it"),
        (p2os.packet(b"\x20Pioneer"), "does not tell whether its watchdog stops it"),
    ],
)
def test_robot_that_cannot_stand_in_time_says_so_and_drives_freely(answer: bytes, problem: str) -> None:
    robot = Robot({**HANDSHAKE, command(PioneerCommand.CONFIG): answer})
    assert robot.base.is_connected
    assert robot.base.limits.linear_m_per_s == 1.2
    robot.device.send(sip())
    (reading,) = robot.base.poll()
    assert reading.problems == (problem,)
    robot.device.taken()
    robot.base.command(0.8, 0.5, 0.3)
    assert robot.device.taken() == command(PioneerCommand.SPEED, 800) + command(PioneerCommand.TURN_RATE, 29)


def test_robot_whose_watchdog_leaves_it_hardly_any_speed_says_so() -> None:
    robot = Robot({**HANDSHAKE, command(PioneerCommand.CONFIG): parameters(watchdog_ms=345)})
    assert robot.base.limits.linear_m_per_s == pytest.approx(0.01)
    robot.device.send(sip())
    (reading,) = robot.base.poll()
    assert reading.problems == ("drives at most 0.01 m/s: its watchdog waits 0.345 s",)


def test_speed_is_not_limited_if_nobody_asks_for_it() -> None:
    robot = Robot(stands_within_s=0.0)
    assert robot.base.limits.linear_m_per_s == 1.2


def test_reports_that_jitter_are_stamped_at_their_period() -> None:
    robot = Robot({**HANDSHAKE, command(PioneerCommand.CONFIG): parameters(report_ms=50)})
    began_s, errors = robot.clock.now_s, []
    sent_s = len(sip()) * 10 / 9_600
    for number in range(200):
        made_s = began_s + 0.05 * number
        robot.clock.now_s = made_s + sent_s + (0.03 if number % 30 == 7 else 0.002 * (number * 7 % 11) / 10)
        robot.device.send(sip())
        (reading,) = robot.base.poll()
        errors.append(reading.state.stamp_s - made_s)
    assert max(map(abs, errors[20:])) < 0.001
