"""Dynamixel servos with protocol 1.0: driver and maker's library both understand the emulated ones."""

import math
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import dynamixel_sdk
import pytest

from robbie_robots.hw.dynamixel.protocol1_joints import Protocol1Joint, Protocol1Joints
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.dynamixel1 import (
    AX_12,
    CCW_LIMIT,
    GOAL,
    MX_28,
    TORQUE,
    EmulatedOldServos,
    OldServo,
)
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.joints import JointReading
from tests.hw._support.guards import guards

LIMIT_S = 20.0
AX_STEP_RAD = math.radians(300) / 1023
# The second joint has an MX-28.
ARM = [Protocol1Joint(f"joint{number}", speed_rad_per_s=8.0, servo=number) for number in (1, 2, 3)]


@pytest.fixture
def line(tmp_path: Path) -> Iterator[EmulatedLine]:
    emulated = EmulatedOldServos({1: AX_12, 2: MX_28, 3: AX_12, 4: AX_12})
    with EmulatedLine(emulated, PseudoTerminal(tmp_path / "servos")) as made:
        yield made


def servo(line: EmulatedLine, number: int) -> OldServo:
    assert isinstance(line.device, EmulatedOldServos)
    return line.device.servos[number]


def until(
    joints: Protocol1Joints, is_reached: Callable[[JointReading], bool], goals: dict[str, float] | None = None
) -> JointReading:
    """Command the joints until a reading is as it should be, and return it."""
    give_up_s = time.monotonic() + LIMIT_S
    while time.monotonic() < give_up_s:
        if goals and joints.is_connected:
            joints.command(goals, 0.3)
        for reading in joints.poll(0.05):
            if is_reached(reading):
                return reading
    raise AssertionError(f"not reached: {joints.reason}")


@pytest.mark.parametrize("echoes", [False, True])
def test_joints_of_both_series_go_where_they_are_told_and_are_let_go_when_the_command_expires(
    line: EmulatedLine, echoes: bool
) -> None:
    assert isinstance(line.device, EmulatedOldServos)
    line.device.echoes = echoes  # a line of two wires
    with closing(Protocol1Joints(line.url, ARM)) as arm:
        before = until(arm, lambda _: True).positions_rad
        goals = {"joint1": 0.3, "joint2": -0.2}
        reading = until(
            arm,
            lambda one: abs(one.positions_rad[0] - 0.3) < 0.004 and abs(one.positions_rad[1] + 0.2) < 0.002,
            goals,
        )
        assert reading.positions_rad[2] == before[2]
        assert reading.problems == ()
        assert servo(line, 1).steps == pytest.approx(511.5 + 0.3 / AX_STEP_RAD, abs=1.0)
        assert servo(line, 2).steps == pytest.approx(2047.5 - 0.2 / math.tau * 4096, abs=1.0)
        until(arm, lambda _: not arm.has_torque)
        until(arm, lambda _: not any(servo(line, number).table[TORQUE] for number in (1, 2, 3)))
        assert arm.expired_commands >= 1


def test_driver_that_is_stopped_in_a_command_until_it_has_expired_lets_the_joints_go_at_once(
    line: EmulatedLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(Protocol1Joints(line.url, ARM)) as arm:
        until(arm, lambda one: one.positions_rad[0] > 0.29, {"joint1": 0.3})
        before, expired = servo(line, 1).get(GOAL), arm.expired_commands
        with monkeypatch.context() as patch:
            passed_s = iter([0.0])
            patch.setattr(arm, "_monotonic", lambda: time.monotonic() + next(passed_s, 0.4))
            arm.command({"joint1": 1.0}, 0.3)
        assert arm.expired_commands == expired + 1 and not arm.has_torque
        until(arm, lambda _: not servo(line, 1).table[TORQUE])
        assert servo(line, 1).get(GOAL) == before


def test_servo_keeps_its_place_when_its_torque_comes_on(line: EmulatedLine) -> None:
    with closing(Protocol1Joints(line.url, ARM)) as arm:
        until(arm, lambda _: True)
        servo(line, 3).put(GOAL, 900)  # from an earlier run
        until(arm, lambda one: one.positions_rad[0] > 0.2, {"joint1": 1.0})
        assert servo(line, 3).get(GOAL) == 512


def test_servos_are_let_go_by_the_guard_when_the_driver_hangs(line: EmulatedLine) -> None:
    with closing(Protocol1Joints(line.url, ARM[:1])) as arm:
        until(arm, lambda _: arm.has_torque, {"joint1": 0.5})
        assert arm.is_guarded
        arm.command({"joint1": 3.0}, 60.0)
        give_up_s = time.monotonic() + LIMIT_S
        while servo(line, 1).table[TORQUE]:  # nobody polls: the driver hangs
            assert time.monotonic() < give_up_s
            time.sleep(0.005)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_joints_hold_where_they_are_after_their_guard_is_lost_until_a_new_one_answers(
    line: EmulatedLine, how: signal.Signals
) -> None:
    slow = Protocol1Joint("joint1", speed_rad_per_s=0.5, servo=1)
    goal = {"joint1": 2.0}
    with closing(Protocol1Joints(line.url, [slow])) as arm:
        until(arm, lambda one: one.positions_rad[0] > 0.1, goal)
        wanted = servo(line, 1).get(GOAL)
        guard = guards()[0]
        guard.send_signal(how)
        until(arm, lambda _: arm.guards_replaced == 1, goal)
        give_up_s = time.monotonic() + LIMIT_S
        while servo(line, 1).get(GOAL) == wanted:
            assert time.monotonic() < give_up_s
            time.sleep(0.005)
        reading = until(arm, lambda one: bool(one.problems))
        assert reading.problems[0].startswith("the stop guard")
        until(arm, lambda _: arm.is_guarded)
        assert servo(line, 1).get(GOAL) < wanted
        until(arm, lambda one: servo(line, 1).get(GOAL) == wanted and not one.problems, goal)
        assert not guard.is_running()


def test_joints_whose_guard_cannot_start_are_not_moved(
    line: EmulatedLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with closing(Protocol1Joints(line.url, ARM[:1])) as arm:
        until(arm, lambda _: arm.ignored_commands >= 3, {"joint1": 1.0})
        assert not arm.has_torque and not servo(line, 1).table[TORQUE]


def test_lost_release_is_repeated_until_the_servos_obey(line: EmulatedLine) -> None:
    with closing(Protocol1Joints(line.url, ARM[:1])) as arm:
        until(arm, lambda _: True)
        servo(line, 1).table[TORQUE] = 1
        until(arm, lambda _: not servo(line, 1).table[TORQUE])
        assert arm.repeated_releases >= 1


def test_joint_may_be_reversed_and_keeps_to_its_limits_and_the_servos(line: EmulatedLine) -> None:
    servo(line, 1).put(CCW_LIMIT, 550)
    joints = [
        Protocol1Joint("tilt", -0.1, 0.1, 8.0, servo=4, zero_step=300, is_reversed=True),
        Protocol1Joint("pan", servo=1, speed_rad_per_s=8.0),
    ]
    with closing(Protocol1Joints(line.url, joints)) as unit:
        goals = {"tilt": 2.0, "pan": 2.0}
        until(unit, lambda one: abs(one.positions_rad[0] - 0.1) < 0.004, goals)
        until(unit, lambda _: servo(line, 1).steps == 550, goals)
        assert servo(line, 4).steps == pytest.approx(300 - 0.1 / AX_STEP_RAD, abs=1)


def test_unplugged_servos_come_back_without_torque(line: EmulatedLine) -> None:
    with closing(Protocol1Joints(line.url, ARM)) as arm:
        until(arm, lambda one: one.positions_rad[0] > 0.05, {"joint1": 1.0})
        line.unplug()
        while arm.is_connected:
            arm.poll(0.05)
        line.plug_in()
        until(arm, lambda _: True)
        assert servo(line, 1).table[TORQUE] == 0 and not arm.has_torque


def test_errors_are_told_and_damage_does_not_matter(line: EmulatedLine) -> None:
    with closing(Protocol1Joints(line.url, ARM, silence_s=10.0)) as arm:
        until(arm, lambda _: True)
        servo(line, 2).errors = 0x25
        reading = until(arm, lambda one: bool(one.problems))
        assert set(reading.problems) == {
            f"joint2: {text}" for text in ("input voltage", "overheated", "overloaded")
        }
        servo(line, 2).errors = 0
        line.faults = Faults(cut_share=0.1, noise_share=0.1)
        for _ in range(5):
            until(arm, lambda one: not one.problems)


def test_servo_that_switches_itself_off_is_told(line: EmulatedLine) -> None:
    with closing(Protocol1Joints(line.url, ARM)) as arm:
        until(arm, lambda _: arm.has_torque, {"joint1": 0.0})
        arm.command({"joint1": 0.0}, 60.0)
        servo(line, 3).table[TORQUE] = 0
        reading = until(arm, lambda one: bool(one.problems))
        assert reading.problems == ("joint3: has switched its torque off",)


@pytest.mark.parametrize(
    ("address", "value", "reason"),
    [
        (0, 999, "servo 1 at .* is of model 999"),
        (CCW_LIMIT, 0, "servo 1 at .* turns without end"),
        (16, 0, "servo 1 at .* does not answer"),
    ],
)
def test_servo_that_cannot_be_used_is_named(
    line: EmulatedLine, address: int, value: int, reason: str
) -> None:
    servo(line, 1).put(address, value)
    with closing(Protocol1Joints(line.url, ARM[:1])) as joint:
        joint.poll(0.0)
        assert not joint.is_connected
        assert re.search(reason, joint.reason)


@pytest.mark.parametrize(("numbers", "watchdog_s"), [([], 0.2), ([1, 1], 0.2), ([254], 0.2), ([1], 0.0)])
def test_impossible_servos_are_refused(numbers: list[int], watchdog_s: float) -> None:
    joints = [Protocol1Joint("a", servo=one) for one in numbers]
    with pytest.raises(ValueError, match=r"must be|needs a servo"):
        Protocol1Joints("/dev/none", joints, watchdog_s=watchdog_s)


def test_makers_library_moves_and_reads_the_emulated_servos(tmp_path: Path) -> None:
    emulated = EmulatedOldServos({1: AX_12, 2: MX_28, 3: MX_28})
    with EmulatedLine(emulated, PseudoTerminal(tmp_path / "servos")) as line:
        port, packets = dynamixel_sdk.PortHandler(line.url), dynamixel_sdk.Protocol1PacketHandler()
        assert port.openPort() and port.setBaudRate(1_000_000)
        try:
            port.setPacketTimeout = lambda _length: port.setPacketTimeoutMillis(2000)
            assert packets.ping(port, 1) == (12, 0, 0)
            assert packets.ping(port, 2) == (29, 0, 0)
            assert packets.write2ByteTxRx(port, 1, 30, 2000) == (0, 2)  # beyond its limits
            assert packets.write1ByteTxRx(port, 1, 36, 1) == (0, 8)  # read only
            assert packets.write2ByteTxRx(port, 1, 30, 540) == (0, 0)
            assert packets.read1ByteTxRx(port, 1, 24) == (1, 0, 0)
            give_up_s = time.monotonic() + LIMIT_S
            while packets.read2ByteTxRx(port, 1, 36) != (540, 0, 0):
                assert time.monotonic() < give_up_s
            write = dynamixel_sdk.GroupSyncWrite(port, packets, 32, 2)
            assert write.addParam(2, [10, 0]) and write.addParam(3, [20, 1]) and write.txPacket() == 0
            assert [packets.read2ByteTxRx(port, number, 32) for number in (2, 3)] == [(10, 0, 0), (276, 0, 0)]
            emulated.servos[1].errors = 36
            assert packets.read1ByteTxRx(port, 1, 43) == (30, 0, 36)
        finally:
            port.closePort()
