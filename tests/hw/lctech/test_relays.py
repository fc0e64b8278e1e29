"""The driver of a relay board switches an emulated one, which obeys the maker's protocol."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from robbie_mp import CallRefused, ModuleHarness
from robbie_mp.messages import DeviceState, LightsState, SetLight
from robbie_robots.hw.connection.errors import DeviceSilent
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.lcus import EmulatedRelays
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.lctech.relay_protocol import RelayAnswer, RelayFraming, switch
from robbie_robots.hw.lctech.relays import RelayLights
from robbie_robots.hw.lights import LightsError
from robbie_robots.modules.devices.lights import RelayLightsModule

LIMIT_S = 20.0
NAMES = ["headlight", "rear light"]


@pytest.fixture
def board() -> EmulatedRelays:
    return EmulatedRelays()


@pytest.fixture
def line(board: EmulatedRelays, tmp_path: Path) -> Iterator[EmulatedLine]:
    with EmulatedLine(board, PseudoTerminal(tmp_path / "board")) as made:
        yield made


def until(lights: RelayLights, is_reached: Callable[[], bool]) -> None:
    """Poll until something is so."""
    give_up_s = time.monotonic() + LIMIT_S
    while not is_reached():
        assert time.monotonic() < give_up_s, f"not reached: {lights.reason}"
        lights.poll(0.02)


@pytest.mark.parametrize(
    ("relay", "close", "command"),
    [
        (1, True, "A0 01 01 A2"),
        (1, False, "A0 01 00 A1"),
        (2, True, "A0 02 01 A3"),
        (8, False, "A0 08 00 A8"),
    ],
)
def test_commands_are_those_of_the_maker(relay: int, close: bool, command: str) -> None:
    assert switch(relay, close=close) == bytes.fromhex(command)


def test_no_command_is_made_for_a_relay_that_no_board_has() -> None:
    with pytest.raises(ValueError, match="from 1 to 8, not 9"):
        switch(9, close=True)


def test_answers_are_read_in_both_spellings_and_damaged_ones_dropped() -> None:
    decoder = FrameDecoder(RelayFraming())
    found = decoder.feed(b"CH1: ON\r\nCH2:OFF \r\nCH3: OCH1: OFF\r\nCH9: ON\r\nCH2: ON")
    assert found == [RelayAnswer(1, True), RelayAnswer(2, False), RelayAnswer(1, False)]
    assert decoder.damaged == 2
    assert decoder.feed(b"\r\n") == [RelayAnswer(2, True)]


def test_emulated_board_ignores_commands_with_a_wrong_sum(board: EmulatedRelays) -> None:
    board.receive(bytes.fromhex("A0 01 01 A3 A0 02 01 A3 A0 03 01 A4"))
    assert board.closed == [False, True]


def test_light_is_switched_and_dark_again_when_the_driver_ends(
    board: EmulatedRelays, line: EmulatedLine
) -> None:
    board.closed = [True, True]  # an earlier host has left them on
    with closing(RelayLights(line.url, NAMES)) as lights:
        assert lights.read() is None
        with pytest.raises(DeviceSilent):
            lights.shine("headlight", 1.0)
        until(lights, lambda: lights.is_connected and board.closed == [False, False])
        assert lights.shine("rear light", 0.2) == 1.0, "a relay does not dim"
        until(lights, lambda: board.closed == [False, True])
        assert lights.read() == (0.0, 1.0)
        for name, brightness in (("laser", 1.0), ("headlight", 1.1), ("headlight", float("nan"))):
            with pytest.raises(LightsError):
                lights.shine(name, brightness)
    give_up_s = time.monotonic() + LIMIT_S
    while board.closed != [False, False]:
        assert time.monotonic() < give_up_s


def test_lost_command_is_repeated_by_what_the_board_tells(board: EmulatedRelays, line: EmulatedLine) -> None:
    with closing(RelayLights(line.url, NAMES, silence_s=10.0)) as lights:
        until(lights, lambda: lights.tells)
        lights.shine("headlight", 1.0)
        until(lights, lambda: board.closed[0])
        board.closed[0] = False  # as if the command had been lost
        until(lights, lambda: board.closed[0])
        assert lights.repeated >= 1


def test_replugged_lights_stay_dark_until_the_next_command(board: EmulatedRelays, line: EmulatedLine) -> None:
    with closing(RelayLights(line.url, NAMES, silence_s=10.0)) as lights:
        until(lights, lambda: lights.tells)
        lights.shine("headlight", 1.0)
        until(lights, lambda: board.closed[0])
        line.unplug()
        until(lights, lambda: not lights.is_connected)
        assert lights.read() is None
        line.plug_in()
        until(lights, lambda: lights.is_connected)
        assert lights.read() == (0.0, 0.0)
        line.faults = Faults(cut_share=0.1)
        lights.shine("headlight", 1.0)
        until(lights, lambda: board.closed == [True, False])


def test_board_that_tells_nothing_is_switched_and_counts_as_there(tmp_path: Path) -> None:
    board = EmulatedRelays(relays=1)
    with (
        EmulatedLine(board, PseudoTerminal(tmp_path / "board")) as line,
        closing(RelayLights(line.url, ["headlight"], silence_s=0.05)) as lights,
    ):
        until(lights, lambda: lights.is_connected)
        lights.shine("headlight", 1.0)
        until(lights, lambda: board.closed == [True])
        end_s = time.monotonic() + 0.2
        until(lights, lambda: time.monotonic() > end_s)
        assert (lights.is_connected, lights.tells, lights.counters.losses) == (True, False, 0)


def test_silent_board_that_told_its_states_before_counts_as_lost(
    board: EmulatedRelays, line: EmulatedLine
) -> None:
    with closing(RelayLights(line.url, NAMES, silence_s=0.5)) as lights:
        until(lights, lambda: lights.tells)
        line.faults = Faults(is_silent=True)
        until(lights, lambda: lights.counters.losses > 0)


def test_module_switches_lights_on_request_and_tells_them(board: EmulatedRelays, line: EmulatedLine) -> None:
    settings = {"port": line.url, "lights": NAMES, "silence_s": 10.0}
    with ModuleHarness(RelayLightsModule, settings, name="lights") as lights:
        with pytest.raises(CallRefused, match="not connected"):
            lights.call(SetLight(name="headlight", brightness=1.0), topic="lights")
        give_up_s = time.monotonic() + LIMIT_S
        while not any(state.state == "CONNECTED" for state in lights.take(DeviceState)):
            assert time.monotonic() < give_up_s
            lights.advance(0.02)
        assert lights.call(SetLight(name="rear light", brightness=0.5), topic="lights").brightness == 1.0
        told = lights.take(LightsState, "lights")[-1]
        assert (told.name, told.brightness.tolist(), told.can_dim) == (NAMES, [0.0, 1.0], False)
        with pytest.raises(CallRefused, match="there is no light 'horn'"):
            lights.call(SetLight(name="horn", brightness=1.0), topic="lights")
        while not board.closed[1]:
            assert time.monotonic() < give_up_s
        lights.advance(1.5)
        assert lights.module.status.startswith("rear light; ")
