"""The modules of joints follow commands as long as they are valid, and tell where the joints are."""

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import Duration, ModuleHarness
from robbie_mp.messages import (
    ControlState,
    DeviceState,
    EmergencyStop,
    JointCommand,
    JointState,
    PanTiltCommand,
    SetControl,
    replace,
)
from robbie_robots.hw.emulation import dynamixel1
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.dynamixel import ERRORS, GOAL, TORQUE, EmulatedServos
from robbie_robots.hw.emulation.dynamixel1 import EmulatedOldServos
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.modules.devices.joints import DynamixelModule, SimulatedJointsModule
from tests._support.commands import fresh

OVERHEATED = 0x04
LOOK = PanTiltCommand(pan_rad=0.3, valid_for=Duration(sec=1))


def command(valid_for_s: float = 0.5, **positions: float) -> JointCommand:
    goals = np.array(list(positions.values()))
    return JointCommand(name=list(positions), position=goals, valid_for=Duration.from_seconds(valid_for_s))


def until(condition: Callable[[], bool]) -> None:
    """Wait until the emulated servos have heard it."""
    give_up_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)


def degraded(module: ModuleHarness[DynamixelModule]) -> str:
    """Return why a module is degraded, after another look at its servos."""
    module.advance(0.02)
    return module.module.degraded


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


def test_joints_that_are_held_up_while_they_take_a_command_do_not_move_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ModuleHarness(SimulatedJointsModule, {"names": ["gripper"]}, name="gripper") as gripper:
        moved, held_up_s = gripper.module.moved, [0.6]
        take = moved.command

        def take_late(positions_rad: dict[str, float], valid_for_s: float) -> None:
            gripper.clock.advance(held_up_s.pop() if held_up_s else 0.0)
            take(positions_rad, valid_for_s)

        monkeypatch.setattr(moved, "command", take_late)
        gripper.send(fresh(gripper, command(gripper=5.0)), topic="gripper")
        gripper.advance(1.0)
        assert gripper.take(JointState)[-1].position[0] < 0.02


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
            emulated.servos[2].table[ERRORS] = OVERHEATED
            until(lambda: degraded(unit) == "the servos report: tilt: overheated")
            emulated.servos[2].table[ERRORS] = 0
            until(lambda: degraded(unit) == "")
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


def send(arm: Arm, elbow: float, sender: str = "manipulation") -> None:
    """Command the elbow; the sender "page" does so by hand."""
    wanted = replace(fresh(arm, command(0.17, elbow=elbow)), by_hand=sender == "page")
    arm.send(wanted, topic="arm", sender=sender)


def lift(arm: Arm, elbow: float, sender: str = "page") -> float:
    """Command the elbow for a while; return where it is then."""
    for _ in range(4):
        send(arm, elbow, sender)
        arm.advance(0.05)
    return at(arm)


def at(arm: Arm) -> float:
    return float(arm.take(JointState)[-1].position[0])


def control(arm: Arm, mode: int, who: str = "page") -> None:
    arm.send(ControlState(mode=mode, who=who), topic="control", sender="base")


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
    begun = lift(arm, before + 0.05, "manipulation")
    assert lift(arm, begun + 0.3, "manipulation") > begun + 0.15
    assert arm.module.simulated.expired_commands == 0


def test_arm_does_not_begin_to_move_after_an_emergency_stop(arm: Arm) -> None:
    """It went on to a goal that had come just before the stop, as if it pressed there."""
    send(arm, 1.0)
    stop(arm, True)
    assert lift(arm, 1.0) == pytest.approx(0.0, abs=0.03)


def test_gripper_goes_on_pressing_during_an_emergency_stop() -> None:
    with ModuleHarness(SimulatedJointsModule, {"names": ["elbow"]}, name="arm") as arm:
        arm.advance(10.0)
        arm.module.simulated.block("elbow", 0.5)
        lift(arm, -1.0)
        stop(arm, True)
        lift(arm, -1.0)
        assert arm.module.simulated.is_pushing("elbow")


@pytest.mark.parametrize("mode", [ControlState.HOLD, ControlState.MANUAL])
def test_no_module_moves_an_arm_unless_the_robot_is_in_auto_and_its_load_does_not_fall(
    arm: Arm, mode: int
) -> None:
    before = lift(arm, 1.0, "manipulation")
    control(arm, mode)
    for _ in range(5):
        assert lift(arm, 1.0, "manipulation") == pytest.approx(before, abs=0.03)
    arm.advance(1.0)
    assert lift(arm, 1.0, "another module") == pytest.approx(before, abs=0.03)
    arm.advance(1.0)
    control(arm, ControlState.AUTO)
    assert lift(arm, 1.0, "manipulation") > before + 0.15


def test_module_that_went_on_commanding_while_the_robot_held_must_begin_where_the_arm_is(arm: Arm) -> None:
    before = lift(arm, 1.0, "manipulation")
    control(arm, ControlState.HOLD)
    lift(arm, 1.0, "manipulation")
    control(arm, ControlState.AUTO)
    assert lift(arm, 1.0, "manipulation") == pytest.approx(before, abs=0.03)
    assert lift(arm, before + 0.09, "manipulation") > before + 0.05


def test_operator_takes_over_the_arm_and_has_the_robot_hold(arm: Arm) -> None:
    control(arm, ControlState.AUTO)
    before = lift(arm, 1.0, "manipulation")
    for _ in range(8):
        send(arm, 1.0, "manipulation")
        send(arm, -1.0, "page")
        arm.advance(0.05)
    assert at(arm) < before - 0.3
    (order,) = arm.take(SetControl)
    assert (order.mode, order.reason) == (ControlState.HOLD, "page moves arm by hand")
    assert "7 refused commands" in arm.module.status
    control(arm, ControlState.HOLD, who="arm")
    assert lift(arm, -1.0) < before - 0.4


def test_module_holds_the_arm_where_the_operator_has_left_it(arm: Arm) -> None:
    control(arm, ControlState.AUTO)
    lift(arm, 1.0, "manipulation")
    lift(arm, -1.0)
    control(arm, ControlState.HOLD, who="arm")
    moved = lift(arm, -1.0)
    assert moved < -0.1
    arm.advance(0.2)
    moved = at(arm)
    for _ in range(5):
        assert lift(arm, 1.0, "manipulation") == pytest.approx(moved, abs=0.03)


def test_module_of_a_robot_without_a_base_does_not_take_the_arm_back(arm: Arm) -> None:
    lift(arm, 1.0, "manipulation")
    for _ in range(8):
        send(arm, 1.0, "manipulation")
        send(arm, -1.0, "page")
        arm.advance(0.05)
    moved = at(arm)
    for _ in range(5):
        assert lift(arm, 1.0, "manipulation") == pytest.approx(moved, abs=0.2)  # until the last one expires
    assert not arm.take(SetControl)


def test_order_to_hold_stops_an_operator_who_moves_the_arm(arm: Arm) -> None:
    control(arm, ControlState.AUTO)
    before = lift(arm, 1.0)
    control(arm, ControlState.HOLD, who="another page")
    assert lift(arm, 1.0) == pytest.approx(before, abs=0.03)
    arm.advance(0.6)
    assert lift(arm, 1.0) > before + 0.15


def test_of_two_modules_one_moves_the_arm_until_it_is_silent(
    arm: Arm, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(20):
        send(arm, 1.0, "manipulation")
        send(arm, -1.0, "waving")
        arm.advance(0.05)
    assert at(arm) > 0.9
    assert "20 refused commands" in arm.module.status
    assert "refused a command of waving: manipulation moves the joints (16 refused)" in caplog.text
    assert caplog.text.count("refused a command") == 5
    arm.advance(0.5)
    assert lift(arm, -1.0, "waving") < 0.9


def test_arm_whose_command_has_expired_does_not_move_during_an_emergency_stop(arm: Arm) -> None:
    before = lift(arm, 1.0)
    arm.advance(0.3)
    before = at(arm)
    stop(arm, True)
    assert lift(arm, 1.0) == pytest.approx(before, abs=0.03)


def test_restarted_arm_stands_until_a_base_that_died_too_is_back_and_lets_it_go(arm: Arm) -> None:
    lift(arm, 1.0)
    stop(arm, True)
    arm.advance(0.02)
    with ModuleHarness(
        SimulatedJointsModule, {"names": ["elbow"]}, name="arm", restored=arm.checkpoint
    ) as again:
        again.advance(1.0)
        before = at(again)
        assert lift(again, 1.0) == lift(again, 1.0, "manipulation") == pytest.approx(before, abs=0.03)
        stop(again, False)
        again.advance(1.0)
        assert lift(again, 1.0) > before + 0.15


def test_restarted_arm_follows_no_module_if_the_robot_held(arm: Arm) -> None:
    control(arm, ControlState.HOLD)
    arm.advance(0.02)
    with ModuleHarness(
        SimulatedJointsModule, {"names": ["elbow"]}, name="arm", restored=arm.checkpoint
    ) as again:
        again.advance(1.0)
        before = at(again)
        assert lift(again, 1.0, "manipulation") == pytest.approx(before, abs=0.03)
        assert lift(again, 1.0) > before + 0.15, "an operator drives it"


def test_no_module_turns_a_pan_tilt_unit_while_the_robot_holds() -> None:
    with ModuleHarness(SimulatedJointsModule, {"names": ["pan", "tilt"]}, name="head") as head:
        head.advance(10.0)
        control(head, ControlState.HOLD)
        head.send(fresh(head, command(pan=0.2)), topic="head", sender="mission")
        head.send(fresh(head, LOOK))
        head.advance(0.4)
        assert at(head) == 0.0
        by_hand = replace(fresh(head, command(pan=-0.1)), by_hand=True)
        head.send(by_hand, topic="head", sender="page")
        head.advance(0.4)
        assert at(head) == pytest.approx(-0.1)
        head.advance(1.0)
        head.send(fresh(head, LOOK))
        control(head, ControlState.AUTO)
        head.advance(0.6)
        assert at(head) == pytest.approx(0.3)
        assert not head.take(SetControl)


def test_direction_that_expired_while_the_robot_held_turns_nothing_afterwards() -> None:
    with ModuleHarness(SimulatedJointsModule, {"names": ["pan", "tilt"]}, name="head") as head:
        control(head, ControlState.HOLD)
        head.send(fresh(head, LOOK))
        head.advance(1.1)
        control(head, ControlState.AUTO)
        head.advance(0.6)
        assert at(head) == 0.0
