"""Commands over a link: they stop with the link, and the emergency stop arrives."""

import os
import signal
import time
from collections.abc import Callable

import pytest

from tests._support.robot import Robot, wait_until
from tests.connect.link._support.pair import Pair

PILOT = '  pilot: {class: "crew.modules:Pilot"}'
WHEELS = '  wheels: {class: "crew.modules:Wheels"}'


@pytest.mark.slow
@pytest.mark.every_turn
def test_no_command_arrives_late_or_of_a_held_stick_after_a_stopped_link_goes_on(robot: Robot) -> None:
    pair = Pair(robot, PILOT, WHEELS)
    pair.start("red", "blue")
    wait_until(lambda: len(pair.numbers("blue", "commands")) > 20)
    link = pair.pid("blue")
    os.kill(link, signal.SIGSTOP)
    try:
        wait_until(stands_still(pair, 0.5))
        before = len(pair.numbers("blue", "commands"))
        wait_until(stands_still(pair, 1.0))
        assert len(pair.numbers("blue", "commands")) == before
    finally:
        os.kill(link, signal.SIGCONT)
    wait_until(lambda: (state := pair.state("blue")) is not None and state.late >= 3)
    time.sleep(0.3)
    assert len(pair.numbers("blue", "commands")) == before
    let_go = pair.output("red") / "let_go"
    let_go.touch()
    wait_until(lambda: len(pair.numbers("blue", "commands")) > before)
    let_go.unlink()
    wait_until(lambda: len(pair.numbers("blue", "commands")) > before + 20)
    # What had waited in the stopped link is counted as late; each command that arrives is still valid.
    wait_until(lambda: (state := pair.state("blue")) is not None and state.late >= 3)
    assert all(0 < left_ms <= 220 for left_ms in pair.numbers("blue", "commands"))


@pytest.mark.slow
def test_the_emergency_stop_arrives(robot: Robot) -> None:
    pair = Pair(robot, PILOT, WHEELS)
    pair.start("red", "blue")
    wait_until(lambda: len(pair.numbers("blue", "commands")) > 5)
    (pair.output("red") / "stop").touch()
    wait_until(lambda: 1 in pair.numbers("blue", "stops"), limit_s=10.0)


def stands_still(pair: Pair, seconds: float) -> Callable[[], bool]:
    """Whether no command has come for some time."""
    last = [float(len(pair.numbers("blue", "commands"))), time.monotonic()]

    def is_so() -> bool:
        count = len(pair.numbers("blue", "commands"))
        if count != last[0]:
            last[:] = [count, time.monotonic()]
        return time.monotonic() - last[1] > seconds

    return is_so
