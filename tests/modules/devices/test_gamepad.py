"""The gamepad drives only while its dead-man button is held; one that is pulled out stops the robot.

This machine may have no uinput, so a named pipe of `input_event` structures plays the gamepad.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import DeviceState, DriveCommand, Mark
from robbie_robots.hw.gamepad import EV_ABS, EV_KEY, EV_SYN, EVENT, SYN_DROPPED, GamepadEvents
from robbie_robots.modules.devices.gamepad import ABS_X, ABS_Y, LEFT_SHOULDER, SELECT, GamepadModule

REPORT = (EV_SYN, 0, 0)
HOLD = (EV_KEY, LEFT_SHOULDER, 1)
LET_GO = (EV_KEY, LEFT_SHOULDER, 0)
FORWARD = (EV_ABS, ABS_Y, -32768)
LEFT = (EV_ABS, ABS_X, -32768)


def events(*described: tuple[int, int, int]) -> bytes:
    return b"".join(EVENT.pack(0, 0, *each) for each in (*described, REPORT))


class Operator:
    """The module, and the other end of its gamepad."""

    def __init__(self, harness: ModuleHarness[GamepadModule], path: Path) -> None:
        self.harness, self.path = harness, path
        self.pipe = -1

    def plug_in(self) -> None:
        os.mkfifo(self.path)
        self.harness.advance(0.1)
        self.pipe = os.open(self.path, os.O_WRONLY | os.O_NONBLOCK)

    def unplug(self) -> None:
        self.path.unlink()
        os.close(self.pipe)
        self.pipe = -1

    def does(self, *described: tuple[int, int, int]) -> list[DriveCommand]:
        """Do this; return the commands of the next tick."""
        self.harness.take(DriveCommand)
        if described:
            os.write(self.pipe, events(*described))
        self.harness.advance(0.05)
        return self.harness.take(DriveCommand, "manual")


@pytest.fixture
def operator(tmp_path: Path) -> Iterator[Operator]:
    path = tmp_path / "gamepad"
    with ModuleHarness(GamepadModule, {"device": str(path)}) as harness:
        made = Operator(harness, path)
        made.plug_in()
        yield made
    if made.pipe >= 0:
        os.close(made.pipe)


def speeds(commands: list[DriveCommand]) -> list[tuple[float, float]]:
    return [(command.linear_m_per_s, command.angular_rad_per_s) for command in commands]


def test_stick_without_the_dead_man_button_commands_nothing(operator: Operator) -> None:
    assert operator.does(FORWARD) == []


def test_stick_with_the_dead_man_button_drives_forward_and_left(operator: Operator) -> None:
    (command,) = operator.does(HOLD, FORWARD, LEFT)
    assert speeds([command]) == [pytest.approx((0.5, 1.0))]
    assert command.valid_for.nanoseconds == 250_000_000


def test_letting_go_stops_the_robot_once(operator: Operator) -> None:
    operator.does(HOLD, FORWARD)
    assert speeds(operator.does(LET_GO)) == [(0.0, 0.0)]
    assert operator.does() == []


def test_pulled_out_gamepad_stops_the_robot_and_never_repeats_its_last_command(operator: Operator) -> None:
    operator.does(HOLD, FORWARD)
    operator.unplug()
    assert speeds(operator.does()) == [(0.0, 0.0)]
    assert [operator.does() for _ in range(5)] == [[]] * 5
    state = operator.harness.take(DeviceState)[-1]
    assert (state.state, state.losses) == ("DISCONNECTED", 1)
    assert operator.harness.module.degraded.startswith("the gamepad is disconnected: ")
    # Plugged in again, the button that was held is not held any more.
    operator.plug_in()
    assert operator.does() == []
    assert operator.does(FORWARD) == []
    assert len(operator.does(HOLD)) == 1


def test_small_push_counts_as_centred(operator: Operator) -> None:
    (command,) = operator.does(HOLD, (EV_ABS, ABS_Y, 3000), (EV_ABS, ABS_X, -3000))
    assert speeds([command]) == [(0.0, 0.0)]


def test_dropped_events_let_go_of_everything() -> None:
    gamepad = GamepadEvents()
    gamepad.feed(events(HOLD, FORWARD))
    assert gamepad.state.pressed == {LEFT_SHOULDER}
    gamepad.feed(events((EV_SYN, SYN_DROPPED, 0), FORWARD))
    assert gamepad.state.pressed == set()
    assert gamepad.dropped == 1


def test_events_are_read_in_pieces_and_count_when_reported() -> None:
    gamepad = GamepadEvents()
    data = events(HOLD)
    assert not any(gamepad.feed(data[i : i + 1]) for i in range(len(data) - 1))
    assert gamepad.state.pressed == set()
    assert gamepad.feed(data[-1:])
    assert gamepad.state.pressed == {LEFT_SHOULDER}


def test_gamepad_held_while_its_module_stood_still_must_be_let_go(operator: Operator) -> None:
    operator.does(HOLD, FORWARD)
    operator.harness.clock.advance(5.0)
    operator.harness.module.tick()
    assert speeds(operator.harness.take(DriveCommand)) == [(0.0, 0.0)]
    assert operator.does() == []
    assert operator.does(LET_GO) == []
    assert speeds(operator.does(HOLD, FORWARD)) == [(0.5, 0.0)]


def test_each_press_of_the_mark_button_marks_once_and_moves_nothing(operator: Operator) -> None:
    presses = [operator.does((EV_KEY, SELECT, held)) for held in (1, 1, 0, 1)]
    assert presses == [[], [], [], []]
    assert [mark.text for mark in operator.harness.take(Mark)] == ["gamepad 1", "gamepad 2"]
