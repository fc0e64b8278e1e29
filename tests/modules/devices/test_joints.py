"""The modules of joints follow commands as long as they are valid, and tell where the joints are."""

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import Duration, ModuleHarness
from robbie_mp.messages import DeviceState, EmergencyStop, JointCommand, JointState, PanTiltCommand
from robbie_robots.hw.emulation import dynamixel1
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.dynamixel import GOAL, TORQUE, EmulatedServos
from robbie_robots.hw.emulation.dynamixel1 import EmulatedOldServos
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.modules.devices.joints import DynamixelModule, SimulatedJointsModule
from tests._support.commands import fresh


def command(valid_for_s: float = 0.5, **positions: float) -> JointCommand:
    goals = np.array(list(positions.values()))
    return JointCommand(name=list(positions), position=goals, valid_for=Duration.from_seconds(valid_for_s))


def until(condition: Callable[[], bool]) -> None:
    """Wait until the emulated servos have heard it."""
    give_up_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)


def test_simulated_gripper_closes_until_its_command_expires() -> None:
    settings = {"names": ["gripper"], "least_rad": [0.0], "most_rad": [1.0]}
    with ModuleHarness(SimulatedJointsModule, settings, name="gripper") as gripper:
        gripper.send(fresh(gripper, command(gripper=5.0)), topic="gripper")
        gripper.advance(0.2)
        gripper.send(fresh(gripper, command(gripper=5.0)), topic="gripper")
        gripper.advance(0.2)
        assert gripper.take(JointState)[-1].position[0] == pytest.approx(0.4, abs=0.03)
        gripper.advance(2.0)
        last = gripper.take(JointState)[-1]
        assert last.position[0] == pytest.approx(0.45, abs=0.03) and last.velocity[0] == 0.0


def test_invalid_commands_move_nothing_and_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    with ModuleHarness(SimulatedJointsModule, {"names": ["a", "b"]}, name="arm") as arm:
        for wrong in (command(c=1.0), command(a=math.nan), command(0.0, a=1.0)):
            arm.send(wrong, topic="arm")
        arm.send(JointCommand(name=["a"], valid_for=Duration.from_seconds(1.0)), topic="arm")
        arm.advance(0.5)
        assert not arm.take(JointState)[-1].position.any()
    assert caplog.text.count("ignored an invalid command") == 2
    assert caplog.text.count("refused an ill-formed message") == 2


def test_pan_tilt_on_servos_follows_both_commands(tmp_path: Path) -> None:
    emulated = EmulatedServos([1, 2])
    with EmulatedLine(emulated, PseudoTerminal(tmp_path / "servos")) as line:
        settings = {"port": line.url, "names": ["pan", "tilt"], "silence_s": 10.0}
        with ModuleHarness(DynamixelModule, settings, name="pan_tilt") as unit:
            unit.advance(0.02)
            assert unit.take(DeviceState)[-1].state == "CONNECTED"
            unit.send(fresh(unit, PanTiltCommand(pan_rad=0.3, tilt_rad=-0.1)))
            until(lambda: emulated.servos[1].table[TORQUE] == 1)
            unit.send(fresh(unit, command(pan=0.1)), topic="pan_tilt")
            until(lambda: emulated.servos[1].get(GOAL) == 2048 + round(0.1 * 4096 / math.tau))
        until(lambda: emulated.servos[1].table[TORQUE] == 0)


def test_older_servo_closes_a_gripper_and_is_let_go_at_the_end(tmp_path: Path) -> None:
    emulated = EmulatedOldServos({7: dynamixel1.AX_12})
    with EmulatedLine(emulated, PseudoTerminal(tmp_path / "servos")) as line:
        settings = {
            "port": line.url,
            "names": ["gripper"],
            "servos": [7],
            "protocol": 1,
            "bit_rate": 1_000_000,
        }
        with ModuleHarness(DynamixelModule, settings | {"silence_s": 10.0}, name="gripper") as gripper:
            gripper.advance(0.02)
            assert gripper.take(DeviceState)[-1].state == "CONNECTED"
            gripper.send(fresh(gripper, command(1.0, gripper=0.3)), topic="gripper")
            until(lambda: emulated.servos[7].table[dynamixel1.TORQUE] == 1)
            assert emulated.servos[7].get(dynamixel1.GOAL) == round(511.5 + 0.3 / (math.radians(300) / 1023))
        until(lambda: emulated.servos[7].table[dynamixel1.TORQUE] == 0)


Arm = ModuleHarness[SimulatedJointsModule]


@pytest.fixture
def arm() -> Iterator[Arm]:
    with ModuleHarness(SimulatedJointsModule, {"names": ["elbow"]}, name="arm") as harness:
        harness.advance(10.0)
        yield harness


def lift(arm: Arm, elbow: float, sender: str = "page") -> float:
    """Command the elbow for a while; return where it is then."""
    for _ in range(4):
        arm.send(fresh(arm, command(0.17, elbow=elbow)), topic="arm", sender=sender)
        arm.advance(0.05)
    return float(arm.take(JointState)[-1].position[0])


def stop(arm: Arm, engaged: bool) -> None:
    arm.send(EmergencyStop(engaged=engaged), topic="emergency_stop_state")


def test_emergency_stop_stops_the_arm_and_its_load_does_not_fall(arm: Arm) -> None:
    before = lift(arm, 1.0)
    assert before > 0.15
    stop(arm, True)
    for _ in range(5):
        assert lift(arm, 1.0) == pytest.approx(before, abs=0.03)
    assert arm.module.simulated.expired_commands == 0


def test_control_of_the_arm_held_since_the_emergency_stop_must_be_let_go(arm: Arm) -> None:
    before = lift(arm, 1.0)
    stop(arm, True)
    stop(arm, False)
    for _ in range(5):
        assert lift(arm, 1.0) == pytest.approx(before, abs=0.03)
    arm.advance(0.6)
    assert lift(arm, 1.0) > before + 0.15


def test_module_whose_arm_never_rests_goes_on_from_where_it_was_stopped(arm: Arm) -> None:
    lift(arm, 1.0, "manipulation")
    stop(arm, True)
    before = lift(arm, 1.0, "manipulation")
    stop(arm, False)
    at = lift(arm, before + 0.05, "manipulation")
    assert lift(arm, at + 0.3, "manipulation") > at + 0.15
    assert arm.module.simulated.expired_commands == 0


def test_gripper_goes_on_pressing_during_an_emergency_stop() -> None:
    with ModuleHarness(SimulatedJointsModule, {"names": ["elbow"]}, name="arm") as arm:
        arm.advance(10.0)
        arm.module.simulated.block("elbow", 0.5)
        lift(arm, -1.0)
        stop(arm, True)
        lift(arm, -1.0)
        assert arm.module.simulated.is_pushing("elbow")
