"""An emulated line judges bytes by the rate that the host had when it wrote them."""

import os
import time
from pathlib import Path

import pytest
import serial

from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.device import EmulatedDevice
from robbie_robots.hw.emulation.line import EmulatedLine

LIMIT_S = 30.0
QUESTION = b"who are you?"


class Listener(EmulatedDevice):
    """Keeps what it hears at 57,600 bit/s."""

    def __init__(self) -> None:
        super().__init__()
        self.heard = b""

    def power_on(self) -> None:
        self.bit_rate = 57_600

    def receive(self, data: bytes) -> None:
        self.heard += data


class HurriedHost(PseudoTerminal):
    """A host that changes its rate and writes in the moment before the line reads."""

    def __init__(self, link: Path, bit_rates: list[int]) -> None:
        super().__init__(link)
        self._bit_rates = bit_rates

    def read(self) -> bytes:
        if self._bit_rates:
            with serial.Serial(str(self.link), self._bit_rates.pop(0)) as port:
                port.write(QUESTION)
        return super().read()


@pytest.mark.parametrize(("bit_rate", "is_understood"), [(57_600, True), (1_000_000, False)])
def test_bytes_written_just_after_a_change_of_rate_are_judged_by_the_new_rate(
    bit_rate: int, is_understood: bool, tmp_path: Path
) -> None:
    device = Listener()
    # The first question comes at a rate that is wrong if the last one's is right, and the other way round.
    before = 1_000_000 if is_understood else 57_600
    with EmulatedLine(device, HurriedHost(tmp_path / "line", [before, bit_rate])):
        give_up_s = time.monotonic() + LIMIT_S
        while len(device.heard) < 2 * len(QUESTION):
            assert time.monotonic() < give_up_s
            os.sched_yield()
    assert (device.heard[: len(QUESTION)] == QUESTION) != is_understood
    assert (device.heard[len(QUESTION) :] == QUESTION) == is_understood
