"""A robot stops when the process that drives it dies or hangs, and when a command expires."""

import os
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from select import select

import psutil
import pytest

from hw.connection.stop_guard import StopGuard
from hw.irobot import open_interface as oi
from robbie_mp.run.supervisor.leftovers import MARKER, kill_child_leftovers, marker
from tests.hw._support import driving
from tests.hw.irobot.test_create import frame

PROJECT = Path(__file__).parents[3]
HALT = oi.drive_direct(0, 0)
DRIVE = oi.drive_direct(200, 200)
STAND_WITHIN_S = 0.4
LIMIT_S = 20.0


class Line:
    """The device's end of a serial line."""

    def __init__(self) -> None:
        self.device, host = os.openpty()
        tty.setraw(host)
        self.path = os.ttyname(host)
        self._host = host
        self.heard = b""

    def listen_until(self, end: bytes, limit_s: float, sent: bytes = b"") -> float:
        """Wait until the bytes heard end so, sending something all the while; return how long it took, s."""
        began_s = time.monotonic()
        while not self.heard.endswith(end):
            passed_s = time.monotonic() - began_s
            assert passed_s < limit_s, f"heard only {self.heard.hex(' ')}"
            if sent:
                os.write(self.device, sent)
            if select([self.device], [], [], 0.01)[0]:
                self.heard += os.read(self.device, 4096)
        return time.monotonic() - began_s

    def close(self) -> None:
        os.close(self.device)
        os.close(self._host)


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.close()


def test_expired_order_stops_the_robot_and_newer_ones_prolong_it(line: Line) -> None:
    host = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
    guard = StopGuard(host, HALT)
    try:
        guard.allow(60.0)
        guard.allow(0.1)
        assert line.listen_until(HALT, LIMIT_S) >= 0.09
        assert line.heard == HALT
    finally:
        guard.close()
        os.close(host)


def test_order_to_stand_lets_nothing_expire(line: Line) -> None:
    host = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
    guard = StopGuard(host, HALT)
    guard.allow(60.0)
    guard.allow(0.0)
    guard.close()
    os.close(host)
    # One stop: the one at the end.
    line.listen_until(HALT, LIMIT_S)
    assert line.heard == HALT


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_robot_stands_after_its_driver_is_killed_or_stopped(line: Line, how: signal.Signals) -> None:
    stand_after(line, how, LIMIT_S)


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_robot_stands_soon_after_its_driver_is_killed_or_stopped(line: Line, how: signal.Signals) -> None:
    stand_after(line, how, STAND_WITHIN_S)


def stand_after(line: Line, how: signal.Signals, limit_s: float) -> None:
    program = subprocess.Popen([sys.executable, "-m", driving.__name__, line.path], cwd=PROJECT)
    try:
        line.listen_until(DRIVE, LIMIT_S, frame())
        program.send_signal(how)
        assert line.listen_until(HALT, LIMIT_S) < limit_s
    finally:
        with suppress(ProcessLookupError):
            program.kill()
        program.wait()
    # The guard has ended, too, and said its last stop: nobody holds the line open any more.
    line.listen_until(HALT, LIMIT_S)


def test_supervisor_that_kills_what_a_dead_module_left_does_not_kill_the_guard(line: Line) -> None:
    mark = marker("guardtest", "base", 1)
    program = subprocess.Popen(
        [sys.executable, "-m", driving.__name__, line.path],
        cwd=PROJECT, env={**os.environ, MARKER: mark}, start_new_session=True,
    )  # fmt: skip
    guards = []
    try:
        line.listen_until(DRIVE, LIMIT_S, frame())
        guards = psutil.Process(program.pid).children()
        for guard in guards:
            guard.suspend()  # so that the supervisor comes first
        program.kill()
        os.waitid(os.P_PID, program.pid, os.WEXITED | os.WNOWAIT)
        assert kill_child_leftovers(program.pid, mark, known=()) == {}
    finally:
        program.kill()
        program.wait()
        for guard in guards:
            guard.resume()
    assert guards
    line.listen_until(HALT, LIMIT_S)
