"""The driver of a pan-tilt unit turns an emulated one, which answers as in the manual's dialogues."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import JointState, PanTiltCommand
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.emulation.ptu import EmulatedPtu
from robbie_robots.hw.flir.ptu import FlirPanTilt
from robbie_robots.hw.pan_tilt import PanTiltError, PanTiltState
from robbie_robots.modules.devices.flir import FlirPanTiltModule
from tests.hw._support.line import Clock, ScriptedDevice

LIMIT_S = 20.0
STEP_RAD = math.radians(0.05)
"""Of the scripted unit, which has 180 arc seconds for a step, and 1,000 steps to each side."""
HANDSHAKE = {b"I ": b"*\r\n"}
for axis in "PT":
    HANDSHAKE |= {
        f"{axis}{what} ".encode(): f"* {value}\r\n".encode()
        for what, value in {"R": 180, "N": -1000, "X": 1000}.items()
    }
    HANDSHAKE[f"{axis}S{round(1 / STEP_RAD)} ".encode()] = b"*\r\n"


@pytest.fixture
def line(tmp_path: Path) -> Iterator[EmulatedLine]:
    with EmulatedLine(EmulatedPtu(), PseudoTerminal(tmp_path / "unit")) as made:
        yield made


def until(unit: FlirPanTilt, is_reached: Callable[[PanTiltState], bool]) -> PanTiltState:
    """Wait until the unit tells a direction as it should be, and return it."""
    give_up_s = time.monotonic() + LIMIT_S
    while time.monotonic() < give_up_s:
        for state in unit.poll(0.05):
            if is_reached(state):
                return state
    raise AssertionError(f"not reached: {unit.reason}")


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        ("PP ", "* Current Pan position is 0"),
        ("FT PP ", "*\r\n* 0"),
        ("PN ", "* Minimum Pan position is -3090"),
        ("FT TX ", "*\r\n* 604"),
        ("PP3200 ", "! Maximum allowable Pan position is 3090"),
        ("PR ", "* 185.1428 seconds arc per Pan position"),
    ],
)
def test_emulated_unit_answers_as_in_the_manual(asked: str, answer: str) -> None:
    unit = EmulatedPtu()
    unit.receive(b"ED ")
    unit.taken()
    unit.receive(asked.encode())
    assert b"".join(unit.taken()).decode() == answer + "\r\n"


def test_unit_turns_to_a_direction_within_its_limits(line: EmulatedLine) -> None:
    with closing(FlirPanTilt(line.url, 2.0)) as unit:
        until(unit, lambda _: True)
        step = math.radians(185.1428 / 3600)
        assert unit.limits.pan_rad == pytest.approx(3090 * step)
        assert (unit.limits.tilt_up_rad, unit.limits.tilt_down_rad) == pytest.approx((604 * step, 907 * step))
        unit.look(0.5, 9.0)
        until(unit, lambda state: abs(state.pan_rad - 0.5) < step and abs(state.tilt_rad - 907 * step) < step)
        assert unit.refused == 0 and unit.read().pan_rad == pytest.approx(0.5, abs=step)
        with pytest.raises(PanTiltError):
            unit.look(math.nan, 0.0)


def test_unit_that_gets_a_new_direction_all_the_time_tells_where_it_looks(line: EmulatedLine) -> None:
    with closing(FlirPanTilt(line.url, 2.0, silence_s=0.5)) as unit:
        until(unit, lambda _: True)
        states, began_s = 0, time.monotonic()
        while time.monotonic() < began_s + 1.5:
            unit.look(0.01 if int(10 * time.monotonic()) % 2 else -0.01, 0.0)
            states += len(unit.poll(0.002))
        assert unit.counters.losses == 0
        assert states > 5
        unit.look(0.2, 0.0)
        until(unit, lambda state: abs(state.pan_rad - 0.2) < 0.001)


def test_only_the_newest_direction_waits_for_a_slow_line() -> None:
    clock, device = Clock(), ScriptedDevice(HANDSHAKE)
    device.wait = clock.pass_time
    unit = FlirPanTilt(
        "scripted",
        clock=clock,
        monotonic=clock,
        open_port=lambda url, rate: device,  # type: ignore[arg-type, return-value]
    )
    unit.poll()
    assert unit.is_connected, unit.reason
    device.taken()
    for number in range(100):
        unit.look(number / 1000, 0.0)
        unit.poll()
    assert device.taken() == b"PP TP "
    device.send(b"* 0\r\n* 0\r\n")
    unit.poll()
    unit.poll()
    assert device.taken() == f"PP{round(0.099 / STEP_RAD)} TP0 ".encode()


def test_unit_whose_limits_leave_out_straight_ahead_is_refused() -> None:
    device = ScriptedDevice({**HANDSHAKE, b"TN ": b"* 100\r\n"})
    unit = FlirPanTilt("scripted", open_port=lambda url, rate: device)  # type: ignore[arg-type, return-value]
    unit.poll()
    assert not unit.is_connected
    assert "limits without straight ahead" in unit.reason


def test_replugged_unit_goes_on_in_spite_of_damage(line: EmulatedLine) -> None:
    with closing(FlirPanTilt(line.url, silence_s=10.0)) as unit:
        until(unit, lambda _: True)
        line.unplug()
        while unit.is_connected:
            unit.poll(0.05)
        line.plug_in()
        until(unit, lambda _: True)
        line.faults = Faults(cut_share=0.1)
        for _ in range(5):
            assert abs(until(unit, lambda _: True).pan_rad) < 0.01


def test_module_follows_commands_and_tells_the_direction(line: EmulatedLine) -> None:
    settings = {"port": line.url, "silence_s": 10.0}
    with ModuleHarness(FlirPanTiltModule, settings, name="pan_tilt") as unit:
        unit.advance(0.01)
        unit.send(PanTiltCommand(pan_rad=0.1, tilt_rad=0.1))
        unit.send(PanTiltCommand(pan_rad=math.nan))
        give_up_s = time.monotonic() + LIMIT_S
        while not any(abs(state.position[0] - 0.1) < 0.001 for state in unit.take(JointState)):
            assert time.monotonic() < give_up_s
            unit.advance(0.01)
