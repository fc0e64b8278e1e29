"""A robot stops when the process that drives it dies or hangs, and when a command expires."""

import os
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from select import select
from threading import Thread

import psutil
import pytest

from robbie_mp.run.supervisor.leftovers import MARKER, kill_child_leftovers, marker
from robbie_robots.hw.connection.stop_guard import END_TIMEOUT_S, FIRST_ANSWER_LIMIT_S, GUARDS, StopGuard
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.irobot import open_interface as oi
from robbie_robots.hw.irobot.create import CreateBase
from tests.hw._support import driving
from tests.hw._support.guards import guards, new_guard
from tests.hw.irobot.test_create import frame

PROJECT = Path(__file__).parents[3]
HALT = oi.drive_direct(0, 0)
DRIVE = oi.drive_direct(200, 200)
STAND_WITHIN_S = 0.4
LIMIT_S = 20.0
# More orders than a pipe holds.
MANY_ORDERS = 10_000
KILLED_OR_STOPPED = pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])


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

    def forget(self) -> None:
        """Read and forget what has arrived."""
        while select([self.device], [], [], 0.0)[0]:
            os.read(self.device, 4096)
        self.heard = b""

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


def test_late_command_of_a_driver_that_hangs_again_does_not_move_the_robot_for_long(line: Line) -> None:
    host = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
    guard = StopGuard(host, HALT)
    try:
        guard.allow(0.05)
        line.listen_until(HALT, LIMIT_S)
        for _ in range(2):
            os.write(host, DRIVE)
            line.listen_until(DRIVE + HALT, LIMIT_S)
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


@KILLED_OR_STOPPED
def test_robot_stands_after_its_driver_is_killed_or_stopped(line: Line, how: signal.Signals) -> None:
    stand_after(line, how, LIMIT_S)


@pytest.mark.slow
@pytest.mark.every_turn
@pytest.mark.alone
@KILLED_OR_STOPPED
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
    suspended = []
    try:
        line.listen_until(DRIVE, LIMIT_S, frame())
        suspended = guards(program.pid)
        program.send_signal(signal.SIGSTOP)  # first, or it would replace its guard
        for guard in suspended:
            guard.suspend()  # so that the supervisor comes before it
        line.forget()
        program.kill()
        os.waitid(os.P_PID, program.pid, os.WEXITED | os.WNOWAIT)
        assert kill_child_leftovers(program.pid, mark, known=()) == {}
        assert line.heard == b""
    finally:
        program.kill()
        program.wait()
        for guard in suspended:
            guard.resume()
    assert suspended
    line.listen_until(HALT, LIMIT_S)


@KILLED_OR_STOPPED
def test_robot_stands_after_its_guard_is_lost_until_a_new_one_answers_and_a_new_order_comes(
    line: Line, how: signal.Signals
) -> None:
    stand_without_guard(line, how, LIMIT_S)


@pytest.mark.slow
@pytest.mark.every_turn
@pytest.mark.alone
@KILLED_OR_STOPPED
def test_robot_stands_soon_after_its_guard_is_lost(line: Line, how: signal.Signals) -> None:
    stand_without_guard(line, how, STAND_WITHIN_S)


def stand_without_guard(line: Line, how: signal.Signals, limit_s: float) -> None:
    """Lose the guard of a robot that is driven all the time."""
    problems: set[str] = set()

    def poll() -> None:
        os.write(line.device, frame())
        for reading in base.poll(0.01):
            problems.update(reading.problems)
        if select([line.device], [], [], 0.0)[0]:
            line.heard += os.read(line.device, 4096)

    def until_heard(end: bytes, limit_s: float, *, is_driven: bool) -> None:
        give_up_s = time.monotonic() + limit_s
        while end not in line.heard:
            assert time.monotonic() < give_up_s, f"heard only {line.heard.hex(' ')}"
            poll()
            if is_driven and base.is_connected:
                base.command(0.2, 0.0, 0.5)

    with closing(CreateBase(line.path)) as base:
        until_heard(DRIVE, LIMIT_S, is_driven=True)
        line.heard = b""
        before = guards()
        before[0].send_signal(how)
        until_heard(HALT, limit_s, is_driven=True)
        assert base.guards_replaced == 1
        line.heard = b""
        give_up_s = time.monotonic() + LIMIT_S
        while not (base.is_guarded and problems):
            assert time.monotonic() < give_up_s
            poll()
        assert DRIVE not in line.heard
        assert any(one.startswith("the stop guard") for one in problems)
        assert new_guard(os.getpid(), before).is_running() and not before[0].is_running()
        until_heard(DRIVE, LIMIT_S, is_driven=True)
        problems.clear()
        poll()
        assert not problems


def test_other_guard_stops_the_robot_if_the_driver_hangs_after_a_command_refused_for_the_lost_one(
    line: Line,
) -> None:
    with closing(CreateBase(line.path)) as base:
        give_up_s = time.monotonic() + LIMIT_S
        while not base.is_guarded:
            assert time.monotonic() < give_up_s
            base.poll(0.02)
        base.command(0.2, 0.0, 0.5)
        line.listen_until(DRIVE, LIMIT_S)
        guards()[0].kill()
        until(lambda: not base.is_guarded, LIMIT_S)
        base.command(0.2, 0.0, 0.5)
        assert base.ignored_commands == 1
        line.listen_until(HALT, LIMIT_S)  # nobody polls


@pytest.mark.parametrize("step", ["_kill", "_start"])
def test_robot_is_stopped_before_its_lost_guard_is_ended_and_replaced(
    line: Line, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """A guard that hangs ends late; a driver may be stopped once the new one runs."""
    heard_at_step: list[bytes] = []

    def take_step(guard: StopGuard) -> None:
        while select([line.device], [], [], 0.05)[0]:
            line.heard += os.read(line.device, 4096)
        heard_at_step.append(line.heard)
        taken(guard)

    taken = getattr(StopGuard, step)
    with closing(CreateBase(line.path)) as base:
        give_up_s = time.monotonic() + LIMIT_S
        while not base.is_guarded:
            assert time.monotonic() < give_up_s
            base.poll(0.02)
        monkeypatch.setattr(StopGuard, step, take_step)
        base.command(0.2, 0.0, 0.5)
        line.forget()
        guards()[0].kill()
        while not heard_at_step:
            assert time.monotonic() < give_up_s
            os.write(line.device, frame())
            base.poll(0.02)
    assert heard_at_step[0] == HALT


def test_guards_that_keep_dying_are_not_replaced_at_once(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or the robot would drive and stop several times a second."""
    started_s: list[float] = []

    def start(guard: StopGuard) -> None:
        started_s.append(time.monotonic())
        start_process(guard)

    start_process = StopGuard._start
    monkeypatch.setattr(StopGuard, "_start", start)
    with closing(CreateBase(line.path)) as base:
        give_up_s = time.monotonic() + LIMIT_S
        while len(started_s) < 3 * GUARDS:
            assert time.monotonic() < give_up_s
            os.write(line.device, frame())
            base.poll(0.02)
            for guard in guards() if base.is_guarded else []:
                guard.kill()
    first_s, second_s, third_s = started_s[::GUARDS]
    assert second_s - first_s >= FIRST_ANSWER_LIMIT_S
    assert third_s - second_s >= FIRST_ANSWER_LIMIT_S


def test_base_whose_guard_cannot_start_does_not_drive(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with closing(CreateBase(line.path)) as base:
        give_up_s = time.monotonic() + LIMIT_S
        while not base.is_connected:
            assert time.monotonic() < give_up_s
            base.poll(0.02)
        for _ in range(3):
            base.command(0.2, 0.0, 0.5)
            base.poll(0.02)
        assert base.ignored_commands == 3 and not base.is_guarded
        line.listen_until(HALT, LIMIT_S)
        assert DRIVE not in line.heard


def test_guard_that_is_stopped_does_not_hang_its_driver(line: Line) -> None:
    host = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
    guard = StopGuard(host, HALT)
    (process,) = guards()

    def order() -> None:
        for _ in range(MANY_ORDERS):
            guard.allow(60.0)

    orders = Thread(target=order, daemon=True)
    try:
        process.suspend()
        orders.start()
        orders.join(LIMIT_S / 4)
        assert not orders.is_alive(), "its orders wait for it"
        until(lambda: not guard.allow(60.0), LIMIT_S)
        began_s = time.monotonic()
        guard.close()
        assert time.monotonic() - began_s < END_TIMEOUT_S
    finally:
        with suppress(psutil.NoSuchProcess):
            process.resume()
        orders.join()
        guard.close()
        os.close(host)


LOST_WITH_THE_DRIVER = pytest.mark.parametrize(
    ("of_driver", "of_guard"),
    [
        (signal.SIGSTOP, signal.SIGKILL),
        (signal.SIGSTOP, signal.SIGSTOP),
        (signal.SIGKILL, signal.SIGSTOP),
        (signal.SIGKILL, signal.SIGKILL),
    ],
)


@LOST_WITH_THE_DRIVER
@pytest.mark.parametrize("number", range(GUARDS))
def test_create_stands_after_its_driver_and_a_guard_are_lost_at_once(
    tmp_path: Path, of_driver: signal.Signals, of_guard: signal.Signals, number: int
) -> None:
    stand_after_loss_at_once(tmp_path, LIMIT_S, of_driver, of_guard, number)


@pytest.mark.slow
@pytest.mark.every_turn
@pytest.mark.alone
@LOST_WITH_THE_DRIVER
def test_create_stands_soon_after_its_driver_and_a_guard_are_lost_at_once(
    tmp_path: Path, of_driver: signal.Signals, of_guard: signal.Signals
) -> None:
    stand_after_loss_at_once(tmp_path, STAND_WITHIN_S, of_driver, of_guard, 0)


def stand_after_loss_at_once(
    folder: Path, limit_s: float, of_driver: signal.Signals, of_guard: signal.Signals, number: int
) -> None:
    create = EmulatedCreate()
    with EmulatedLine(create, PseudoTerminal(folder / "base")) as line:
        program = subprocess.Popen([sys.executable, "-m", driving.__name__, line.url], cwd=PROJECT)
        guard = None
        try:
            until(lambda: any(create.speeds_mm_per_s), LIMIT_S)
            guard = guards(program.pid)[number]
            program.send_signal(of_driver)
            guard.send_signal(of_guard)
            until(lambda: not any(create.speeds_mm_per_s), limit_s)
        finally:
            program.kill()
            program.wait()
            if guard is not None:
                with suppress(psutil.NoSuchProcess):
                    guard.resume()


def test_create_stands_after_its_guard_was_killed_and_then_its_driver_stopped(tmp_path: Path) -> None:
    stand_after_both(tmp_path, LIMIT_S)


@pytest.mark.slow
@pytest.mark.every_turn
@pytest.mark.alone
@pytest.mark.parametrize("drives_again_s", [0.0, 0.02, 0.05, 0.1, 0.5])
def test_create_stands_soon_after_its_guard_was_killed_and_then_its_driver_stopped(
    tmp_path: Path, drives_again_s: float
) -> None:
    stand_after_both(tmp_path, STAND_WITHIN_S, drives_again_s)


def stand_after_both(folder: Path, limit_s: float, drives_again_s: float = 0.1) -> None:
    create = EmulatedCreate()
    with EmulatedLine(create, PseudoTerminal(folder / "base")) as line:
        program = subprocess.Popen([sys.executable, "-m", driving.__name__, line.url], cwd=PROJECT)
        try:
            until(lambda: any(create.speeds_mm_per_s), LIMIT_S)
            before = guards(program.pid)
            before[0].kill()
            new_guard(program.pid, before)
            time.sleep(drives_again_s)
            program.send_signal(signal.SIGSTOP)
            until(lambda: not any(create.speeds_mm_per_s), limit_s)
        finally:
            program.kill()
            program.wait()


def until(is_reached: Callable[[], bool], limit_s: float) -> None:
    give_up_s = time.monotonic() + limit_s
    while not is_reached():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)
