"""Dynamixel servos: the driver and the maker's own library both understand the emulated ones."""

import struct
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import dynamixel_sdk
import pytest

from robbie_robots.hw.dynamixel.servos import DynamixelJoints, ServoJoint
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.dynamixel import ERRORS, MAX_LIMIT, RANGE_ERROR, EmulatedServos
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.joints import JointReading

LIMIT_S = 20.0
ARM = [ServoJoint(f"joint{number}", speed_rad_per_s=2.0, servo=number) for number in range(1, 7)]


@pytest.fixture
def line(tmp_path: Path) -> Iterator[EmulatedLine]:
    with EmulatedLine(EmulatedServos(range(1, 8)), PseudoTerminal(tmp_path / "servos")) as made:
        yield made


def servos(line: EmulatedLine) -> EmulatedServos:
    assert isinstance(line.device, EmulatedServos)
    return line.device


def until(
    joints: DynamixelJoints, is_reached: Callable[[JointReading], bool], goals: dict[str, float] | None = None
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


def test_six_joints_go_where_they_are_told_and_are_let_go_when_the_command_expires(
    line: EmulatedLine,
) -> None:
    with closing(DynamixelJoints(line.url, ARM)) as arm:
        goals = {"joint1": 0.3, "joint6": -0.2}
        reading = until(arm, lambda one: abs(one.positions_rad[0] - 0.3) < 0.002, goals)
        assert reading.positions_rad[5] == pytest.approx(-0.2, abs=0.002)
        assert reading.positions_rad[1:5] == (0.0, 0.0, 0.0, 0.0)
        assert servos(line).servos[1].table[64] == 1
        until(arm, lambda _: not arm.has_torque)
        until(arm, lambda _: servos(line).servos[1].table[64] == 0)
        assert arm.expired_commands >= 1


def test_driver_that_is_stopped_in_a_command_until_it_has_expired_lets_the_joints_go_at_once(
    line: EmulatedLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(DynamixelJoints(line.url, ARM)) as arm:
        until(arm, lambda one: one.positions_rad[0] > 0.29, {"joint1": 0.3})
        before, expired = servos(line).servos[1].table[116:120], arm.expired_commands
        with monkeypatch.context() as patch:
            passed_s = iter([0.0])
            patch.setattr(arm, "_monotonic", lambda: time.monotonic() + next(passed_s, 0.4))
            arm.command({"joint1": 1.0}, 0.3)
        assert arm.expired_commands == expired + 1 and not arm.has_torque
        until(arm, lambda _: not servos(line).servos[1].table[64])
        assert servos(line).servos[1].table[116:120] == before


def test_servos_stop_by_their_own_watchdog_when_the_driver_is_silent(line: EmulatedLine) -> None:
    slow = [ServoJoint("wrist", speed_rad_per_s=0.5, servo=3)]
    with closing(DynamixelJoints(line.url, slow, watchdog_s=0.3)) as wrist:
        until(wrist, lambda one: one.positions_rad[0] > 0.02, {"wrist": 3.0})
        before = wrist.watchdog_stops
        wrist.command({"wrist": 3.0}, 60.0)
        give_up_s = time.monotonic() + LIMIT_S
        while not servos(line).servos[3].is_halted:  # nobody polls: the driver hangs
            assert time.monotonic() < give_up_s
            time.sleep(0.005)
        stopped = servos(line).servos[3].steps
        until(wrist, lambda _: wrist.watchdog_stops > before)
        assert not wrist.has_torque
        until(wrist, lambda _: not servos(line).servos[3].is_halted and not wrist.has_torque)
        assert servos(line).servos[3].steps == stopped
        until(wrist, lambda one: one.positions_rad[0] > 0.1, {"wrist": 3.0})


def test_joint_may_be_reversed_and_have_limits(line: EmulatedLine) -> None:
    tilt = ServoJoint("tilt", -0.1, 0.1, 2.0, servo=2, zero_step=1024, is_reversed=True)
    with closing(DynamixelJoints(line.url, [tilt])) as unit:
        until(unit, lambda one: abs(one.positions_rad[0] - 0.1) < 0.002, {"tilt": 2.0})
        assert servos(line).servos[2].steps == pytest.approx(1024 - 0.1 / 0.001534, abs=1)


def test_unplugged_servos_come_back_without_torque(line: EmulatedLine) -> None:
    with closing(DynamixelJoints(line.url, ARM[:2])) as arm:
        until(arm, lambda one: one.positions_rad[0] > 0.05, {"joint1": 1.0})
        line.unplug()
        while arm.is_connected:
            arm.poll(0.05)
        line.plug_in()
        began_s = time.monotonic()
        until(arm, lambda _: True)
        assert time.monotonic() - began_s < 2.0
        assert servos(line).servos[1].table[64] == 0 and not arm.has_torque


def test_hardware_errors_are_told_and_damage_does_not_matter(line: EmulatedLine) -> None:
    with closing(DynamixelJoints(line.url, ARM[:3], silence_s=10.0)) as arm:
        until(arm, lambda _: True)
        servos(line).servos[2].table[ERRORS] = 0x24
        reading = until(arm, lambda one: bool(one.problems))
        assert reading.problems == ("joint2: overheated", "joint2: overloaded")
        line.faults = Faults(cut_share=0.1, noise_share=0.1)
        for _ in range(5):
            assert until(arm, lambda _: True).positions_rad == (0.0, 0.0, 0.0)


def test_servo_that_refuses_its_goal_is_told(line: EmulatedLine) -> None:
    servos(line).servos[2].put(MAX_LIMIT, 2100)
    with closing(DynamixelJoints(line.url, ARM[:3])) as arm:
        until(arm, lambda one: abs(one.positions_rad[1] - 0.05) < 0.002, {"joint2": 0.05})
        reading = until(arm, lambda one: bool(one.problems), {"joint1": 1.0, "joint2": 1.0})
        assert reading.problems == ("joint2: does not take the goal 2700; what are its limits?",)


def test_servo_that_does_not_take_its_settings_is_named(
    line: EmulatedLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(DynamixelJoints(line.url, [ARM[0], ServoJoint("wrist", servo=2)])) as arm:
        monkeypatch.setattr(servos(line).servos[2], "write", lambda _address, _data: RANGE_ERROR)
        arm.poll(0.0)
        assert arm.reason.startswith(f"servo 2 at {line.url} does not take its settings")


def test_missing_servo_is_named(line: EmulatedLine) -> None:
    with closing(DynamixelJoints(line.url, [ServoJoint("lost", servo=99)])) as joint:
        joint.poll(0.0)
        assert "servo 99" in joint.reason and not joint.is_connected


@pytest.mark.parametrize(("numbers", "watchdog_s"), [([], 0.2), ([1, 1], 0.2), ([253], 0.2), ([1], 3.0)])
def test_impossible_servos_are_refused(numbers: list[int], watchdog_s: float) -> None:
    with pytest.raises(ValueError, match=r"must be|needs a servo"):
        DynamixelJoints("/dev/none", [ServoJoint("a", servo=one) for one in numbers], watchdog_s=watchdog_s)


def test_makers_library_moves_and_reads_the_emulated_servos(line: EmulatedLine) -> None:
    port, packets = dynamixel_sdk.PortHandler(line.url), dynamixel_sdk.Protocol2PacketHandler()
    assert port.openPort() and port.setBaudRate(57_600)
    try:
        # Its time-outs are of some milliseconds: an answer of a busy machine may come too late.
        port.setPacketTimeout = lambda _length: port.setPacketTimeoutMillis(2000)
        assert packets.ping(port, 1) == (1030, 0, 0)
        assert packets.write1ByteTxRx(port, 1, 64, 1) == (0, 0)
        assert packets.write4ByteTxRx(port, 1, 116, 5000) == (0, 4)  # beyond its limits: range error
        assert packets.write1ByteTxRx(port, 1, 11, 3)[1] == 7  # locked while the torque is on: access error
        assert packets.write4ByteTxRx(port, 1, 116, 2100) == (0, 0)
        give_up_s = time.monotonic() + LIMIT_S
        while packets.read4ByteTxRx(port, 1, 132) != (2100, 0, 0):
            assert time.monotonic() < give_up_s
        write = dynamixel_sdk.GroupSyncWrite(port, packets, 64, 1)
        assert write.addParam(2, [1]) and write.addParam(3, [1]) and write.txPacket() == 0
        read = dynamixel_sdk.GroupSyncRead(port, packets, 64, 1)
        assert all(read.addParam(number) for number in (1, 2, 3, 4)) and read.txRxPacket() == 0
        assert [read.getData(number, 64, 1) for number in (1, 2, 3, 4)] == [1, 1, 1, 0]
        # Indirect addresses, with a position whose bytes need stuffing.
        assert packets.writeTxRx(port, 5, 168, 4, struct.pack("<HH", 146, 7)) == (0, 0)
        assert packets.readTxRx(port, 5, 224, 2) == ([30, 5], 0, 0)
    finally:
        port.closePort()
