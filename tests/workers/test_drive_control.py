"""A robot that was stopped, taken over or left by its operator stands until somebody orders it to go on."""

import pytest

from robbie_robots.workers.driving.control import ControlMode, DriveControl

AUTO, MANUAL, HOLD = ControlMode.AUTO, ControlMode.MANUAL, ControlMode.HOLD


class Robot:
    def __init__(self) -> None:
        self.now_s = 10.0
        self.control = DriveControl(lambda: self.now_s)

    def by_hand(self, moves: bool = True, who: str = "page") -> bool:
        """Command by hand; return whether it is followed."""
        return not self.control.refuses_by_hand(who, moves, self.now_s)

    def by_module(self, who: str = "navigation", moves: bool = True) -> bool:
        """Command as a module; return whether it is followed."""
        return not self.control.refuses_module(who, moves, self.now_s)

    def wait(self, time_s: float) -> None:
        for _ in range(round(time_s / 0.1)):
            self.now_s += 0.1
            self.control.look_after()

    def release(self) -> None:
        self.control.see_stop(False, "page", "")


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_modules_drive_until_an_operator_takes_over(robot: Robot) -> None:
    assert robot.by_module()
    assert robot.by_hand()
    assert robot.control.mode is MANUAL
    assert "MANUAL" in robot.control.refuses_module("navigation", True, robot.now_s)


def test_operator_who_lets_go_leaves_a_robot_that_holds(robot: Robot) -> None:
    robot.by_hand()
    robot.wait(0.3)
    assert robot.control.mode is MANUAL
    robot.wait(0.3)
    assert robot.control.mode is HOLD
    robot.wait(60.0)
    assert not robot.by_module()


def test_order_lets_a_holding_robot_go_on(robot: Robot) -> None:
    robot.by_hand()
    robot.wait(1.0)
    assert robot.control.order(AUTO, "page", "", robot.now_s) == ""
    assert robot.by_module()


def test_released_stop_holds_the_robot_until_an_order(robot: Robot) -> None:
    robot.control.see_stop(True, "page", "button")
    assert "emergency stop" in robot.control.order(AUTO, "page", "", robot.now_s)
    robot.release()
    robot.wait(60.0)
    assert robot.control.mode is HOLD
    assert not robot.by_module()
    assert robot.control.order(AUTO, "page", "go on", robot.now_s) == ""


def test_stick_held_during_the_stop_moves_nothing_until_it_was_let_go(robot: Robot) -> None:
    robot.by_hand()
    robot.control.see_stop(True, "page", "button")
    for _ in range(5):
        assert not robot.by_hand()
        robot.wait(0.1)
    robot.release()
    for _ in range(20):
        assert not robot.by_hand()
        robot.wait(0.1)
    assert robot.by_hand(moves=False)
    assert robot.by_hand()


def test_stick_counts_as_let_go_after_silence(robot: Robot) -> None:
    robot.control.see_stop(True, "page", "button")
    robot.release()
    robot.wait(0.6)
    assert robot.by_hand()


def test_release_without_a_stop_changes_nothing(robot: Robot) -> None:
    robot.release()
    assert robot.control.mode is AUTO


def test_letting_go_does_not_take_over_from_hold(robot: Robot) -> None:
    robot.control.order(HOLD, "page", "wait", robot.now_s)
    assert robot.by_hand(moves=False)
    assert robot.control.mode is HOLD


def test_manual_cannot_be_ordered(robot: Robot) -> None:
    assert "first command by hand" in robot.control.order(MANUAL, "page", "", robot.now_s)


@pytest.mark.parametrize("mode", [AUTO, HOLD])
def test_restarted_base_knows_who_was_in_control(robot: Robot, mode: ControlMode) -> None:
    robot.control.order(mode, "page", "test", robot.now_s)
    again = DriveControl(lambda: robot.now_s, before=robot.control.memory())
    assert (again.mode, again.who, again.reason) == (mode, "page", robot.control.reason)


def test_module_that_drove_keeps_control_when_the_base_is_restarted(robot: Robot) -> None:
    robot.control.order(AUTO, "page", "test", robot.now_s)
    assert not robot.control.refuses_module("navigation", True, robot.now_s)
    again = DriveControl(lambda: robot.now_s, before=robot.control.memory())
    assert "navigation drives" in again.refuses_module("exploration", True, robot.now_s + 0.1)
    assert not again.refuses_module("navigation", True, robot.now_s + 0.2)
    robot.now_s += 0.8
    assert not again.refuses_module("exploration", True, robot.now_s)


def test_restarted_base_that_nobody_drove_follows_the_first_module_at_once(robot: Robot) -> None:
    robot.control.order(AUTO, "page", "test", robot.now_s)
    again = DriveControl(lambda: robot.now_s, before=robot.control.memory())
    assert not again.refuses_module("exploration", True, robot.now_s)


def test_restarted_base_still_asks_for_the_release(robot: Robot) -> None:
    robot.control.see_stop(True, "page", "button")
    again = DriveControl(lambda: robot.now_s, before=robot.control.memory())
    assert again.order(AUTO, "page", "", robot.now_s)
    assert again.refuses_by_hand("page", True, robot.now_s)


def test_stick_held_since_the_stop_moves_nothing_after_a_restart_either(robot: Robot) -> None:
    robot.by_hand()
    robot.control.see_stop(True, "page", "button")
    robot.by_hand()
    robot.release()
    robot.control = DriveControl(lambda: robot.now_s, before=robot.control.memory())
    robot.now_s += 0.05
    assert not robot.by_hand()
    robot.now_s += 0.6
    assert robot.by_hand()


def test_stick_held_while_the_base_was_restarted_must_be_let_go(robot: Robot) -> None:
    robot.by_hand()
    robot.control = DriveControl(lambda: robot.now_s, before=robot.control.memory())
    assert robot.control.mode is HOLD
    robot.now_s += 0.05
    assert not robot.by_hand()
    assert robot.by_hand(moves=False)
    assert robot.by_hand()


def test_commands_that_waited_in_a_stopped_base_are_no_sign_that_the_stick_was_let_go(robot: Robot) -> None:
    robot.by_hand()
    robot.control.see_stop(True, "page", "button")
    robot.release()
    sent_s, robot.now_s = robot.now_s, robot.now_s + 5.0  # the base was stopped
    robot.control.look_after()
    while (sent_s := sent_s + 0.05) < robot.now_s:
        assert robot.control.refuses_by_hand("page", True, sent_s)
    robot.wait(0.1)
    assert not robot.by_hand()


def test_stick_held_while_the_base_stood_still_must_be_let_go(robot: Robot) -> None:
    robot.by_hand()
    sent_s, robot.now_s = robot.now_s, robot.now_s + 5.0
    robot.control.look_after()
    assert robot.control.mode is HOLD
    while (sent_s := sent_s + 0.05) < robot.now_s:
        assert robot.control.refuses_by_hand("page", True, sent_s)


def test_another_sender_who_lets_go_does_not_let_go_for_the_one_who_holds_on(robot: Robot) -> None:
    robot.control.see_stop(True, "page", "button")
    robot.by_hand(who="gamepad")
    robot.release()
    for _ in range(20):
        robot.wait(0.1)
        assert robot.by_hand(moves=False, who="teleop")  # such as a stick at rest, over ROS
        assert not robot.by_hand(who="gamepad")


def test_order_to_hold_stops_an_operator_who_holds_on(robot: Robot) -> None:
    robot.by_hand()
    robot.control.order(HOLD, "other page", "somebody is in the way", robot.now_s)
    for _ in range(20):
        robot.wait(0.1)
        assert not robot.by_hand()
    assert robot.control.mode is HOLD
    robot.wait(0.6)
    assert robot.by_hand()


def test_of_two_operators_who_drive_the_newer_one_does(robot: Robot) -> None:
    robot.by_hand(who="page")
    robot.wait(0.1)
    for _ in range(20):
        robot.wait(0.1)
        assert robot.by_hand(who="gamepad")
        assert not robot.by_hand(who="page")
    assert robot.by_hand(moves=False, who="page")
    assert robot.by_hand(who="page")


def test_order_to_go_on_that_cannot_know_of_a_new_order_to_hold_is_refused(robot: Robot) -> None:
    robot.control.see_stop(True, "page", "button")
    robot.release()
    robot.wait(2.0)
    robot.control.order(HOLD, "other page", "a child", robot.now_s)
    robot.wait(0.3)  # so late may a link deliver
    assert "a child" in robot.control.order(AUTO, "page", "", robot.now_s)
    sent_s = robot.now_s
    robot.now_s += 0.5  # the base was stopped meanwhile
    assert "a child" in robot.control.order(AUTO, "page", "", sent_s)
    robot.control = DriveControl(lambda: robot.now_s, before=robot.control.memory())
    assert "a child" in robot.control.order(AUTO, "page", "", sent_s)
    robot.wait(0.3)
    assert robot.control.order(AUTO, "page", "", robot.now_s) == ""


def test_long_reason_is_cut_off(robot: Robot) -> None:
    robot.control.see_stop(True, "page", "x" * 10_000_000)
    assert len(robot.control.memory()["reason"]) <= 200


def test_many_senders_do_not_fill_the_memory(robot: Robot) -> None:
    for number in range(1000):
        robot.by_hand(who=f"tool {number}")
    robot.control.see_stop(True, "page", "")
    assert len(robot.control.memory()["must_let_go"]) <= 64


def test_of_two_modules_that_drive_one_does_until_it_is_silent(robot: Robot) -> None:
    for _ in range(20):
        assert robot.by_module("navigation")
        assert not robot.by_module("exploration")
        robot.wait(0.1)
    assert robot.by_module("navigation", moves=False)  # it waits for a door
    robot.wait(0.4)
    assert "navigation drives" in robot.control.refuses_module("exploration", True, robot.now_s)
    robot.wait(0.2)
    assert robot.by_module("exploration")
    assert not robot.by_module("navigation")


def test_every_module_may_let_the_robot_stand_but_does_not_get_control_by_it(robot: Robot) -> None:
    robot.by_module("navigation")
    assert robot.by_module("obstacles", moves=False)
    assert robot.by_module("navigation")
    robot.wait(1.0)
    assert robot.by_module("obstacles", moves=False)
    assert robot.by_module("navigation")


def test_commands_that_waited_in_a_stopped_base_are_no_silence_of_the_module_that_drives(
    robot: Robot,
) -> None:
    robot.by_module("navigation")
    sent_s, robot.now_s = robot.now_s, robot.now_s + 5.0
    while (sent_s := sent_s + 0.1) < robot.now_s:
        assert robot.control.refuses_module("exploration", True, sent_s)
        assert not robot.control.refuses_module("navigation", True, sent_s)


def test_after_a_hold_another_module_may_drive_at_once(robot: Robot) -> None:
    robot.by_module("navigation")
    robot.control.see_stop(True, "page", "button")
    robot.release()
    robot.control.order(AUTO, "page", "go on", robot.now_s)
    assert robot.by_module("exploration")
