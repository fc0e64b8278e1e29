"""`breakpoint()` in a module opens the debugger in `robbie attach`, and nothing hangs whoever dies."""

import os
import select
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

import pytest

from tests._support import robot as robots
from tests._support.debugger import held_by_debugger
from tests._support.robot import COMMAND, LIMIT_S, Ended, Robot, kill, wait_until

CODE = """
import threading
import time

from robbie_mp import Module, setting
from robbie_mp.messages import DriveCommand


class Laser(Module):
    period_s = 0.01

    def tick(self):
        self.publish(DriveCommand())


class Stumbler(Module):
    stands_in: str = setting("handler", "where it reaches a breakpoint")
    hangs_from: int = setting(0, "the message in which it hangs; 0: none")

    def setup(self):
        self.seen = 0
        self.stand("setup")
        self.subscribe(DriveCommand, self.on_drive)

    def on_drive(self, command):
        self.seen += 1
        if self.seen % 5 == 0:
            self.stand("handler")
        if self.hangs_from and self.seen >= self.hangs_from:
            time.sleep(1000)
        self.status = str(self.seen)

    def stand(self, where):
        if where == self.stands_in:
            found = 6 * 7
            breakpoint()
            self.found = found

    def teardown(self):
        self.stand("teardown")
"""
PROFILE = """
modules:
  laser: {class: "standing:Laser"}
  bumper: {class: "standing:Stumbler", handler_deadline_s: 1, start_deadline_s: 20}
  other: {class: "standing:Stumbler"}
"""
STANDS = "stands at a breakpoint"


class Attached:
    """`robbie attach` with a pipe in place of the keyboard."""

    def __init__(self, process: "subprocess.Popen[str]"):
        assert process.stdin and process.stdout and process.stderr
        self.process = process
        self.stdin: IO[str] = process.stdin
        self.stdout: IO[str] = process.stdout
        self.stderr: IO[str] = process.stderr

    def until(self, text: str) -> str:
        """Read what it prints up to a text."""
        shown = ""
        while not shown.endswith(text):
            character = self.stdout.read(1)
            assert character, (shown, self.stderr.read())
            shown += character
        return shown

    def type(self, line: str) -> None:
        self.stdin.write(f"{line}\n")
        self.stdin.flush()

    def asked(self, line: str) -> str:
        """Type a line; return what follows up to the next prompt."""
        self.type(line)
        return self.until("(Pdb) ")

    def left(self) -> str:
        """Wait for its end; return what it said on standard error."""
        assert self.process.wait(20) == 0
        return self.stderr.read()


@contextmanager
def attached(robot: Robot, name: str = "bumper") -> Iterator[Attached]:
    with subprocess.Popen(
        [*COMMAND, "attach", name],
        cwd=robot.folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield Attached(process)
        finally:
            process.kill()


@pytest.fixture
def standing(robot: Robot) -> Robot:
    (robot.folder / "standing.py").write_text(CODE)
    robot.write_profile(PROFILE)
    return robot


def seen(robot: Robot, name: str = "bumper") -> int:
    return int(robot.top().get(name, {}).get("status") or 0)


def starts(robot: Robot) -> "subprocess.Popen[str]":
    """Start the robot; its modules stand when this returns."""
    process = robot.start()
    robot.until(lambda top: all(one["state"] == "RUNNING" for one in top.values()))
    for name in ("bumper", "other"):
        wait_until(lambda name=name: STANDS in robot.log(name))  # type: ignore[misc]
    return process


def ends(robot: Robot) -> Ended:
    robot.command("stop")
    return Ended.wait_for(robot._started[-1])


@pytest.mark.slow
def test_breakpoint_opens_the_debugger_and_the_watchdog_waits_meanwhile(standing: Robot) -> None:
    process = starts(standing)
    with attached(standing) as terminal, attached(standing, "other") as second:
        assert "standing.py(" in terminal.until("(Pdb) ")
        time.sleep(1.5)  # longer than its deadline
        assert terminal.asked("p self.seen, found") == "(5, 42)\n(Pdb) "
        assert "on_drive" in terminal.asked("w")
        assert "stand()" in terminal.asked("n")
        assert second.until("(Pdb) ")
        assert second.asked("p self.name") == "'other'\n(Pdb) "
        terminal.asked("self.seen = 1000")
        terminal.asked("c")
        assert terminal.asked("p self.seen") == "1005\n(Pdb) "
        terminal.asked("!1 / 0")
        terminal.type("q")
        assert "left; bumper goes on" in terminal.left()
        wait_until(lambda: seen(standing) > 1020)
        assert seen(standing, "other") < 10, "it goes on without its user"
    assert standing.top()["bumper"]["restarts"] == 0, standing.log("bumper")
    assert ends(standing).exit_code == 0, process


@pytest.mark.slow
def test_watchdog_is_given_back(standing: Robot) -> None:
    standing.start("--set", "bumper.hangs_from=7")
    with attached_when_running(standing) as terminal:
        terminal.until("(Pdb) ")
        time.sleep(1.5)
        terminal.type("c")
        standing.until(lambda top: top["bumper"]["restarts"] > 0)
        assert "hung in" in standing.log("bumper")


@contextmanager
def attached_when_running(robot: Robot) -> Iterator[Attached]:
    robot.until(lambda top: top["bumper"]["state"] == "RUNNING")
    with attached(robot) as terminal:
        yield terminal


@pytest.mark.slow
def test_module_that_gdb_holds_does_not_count_as_hung(standing: Robot) -> None:
    standing.start("--set", "bumper.stands_in=nowhere")
    figures = standing.until(
        lambda top: top["bumper"]["state"] == "RUNNING" and bool(top["bumper"]["status"])
    )
    with held_by_debugger(figures["bumper"]["pid"]):
        time.sleep(2.5)  # longer than its deadline
        assert standing.top()["bumper"]["restarts"] == 0
    before = seen(standing)
    wait_until(lambda: seen(standing) > before + 10)
    assert standing.top()["bumper"]["restarts"] == 0


@pytest.mark.slow
def test_module_that_stands_ends_in_order(standing: Robot) -> None:
    starts(standing)
    with attached(standing) as terminal:
        terminal.until("(Pdb) ")
        began_s = time.monotonic()
        ended = ends(standing)
        assert time.monotonic() - began_s < 20
        assert (ended.exit_code, terminal.left().count("the run has ended")) == (0, 1), ended.stderr
    assert ended.modules["bumper"]["lost"] == ended.modules["other"]["restarts"] == 0


@pytest.mark.slow
def test_module_goes_on_when_its_terminal_dies_and_stops_for_the_next_one(standing: Robot) -> None:
    starts(standing)
    for signum in (signal.SIGKILL, signal.SIGSEGV, signal.SIGTERM):  # SIGHUP may be ignored, under nohup
        with attached(standing) as terminal:
            terminal.until("(Pdb) ")
            terminal.process.send_signal(signum)
            before = seen(standing)
            wait_until(lambda before=before: seen(standing) > before + 10)  # type: ignore[misc]
    assert standing.top()["bumper"]["restarts"] == 0
    with attached(standing) as terminal:
        terminal.until("(Pdb) ")
        terminal.stdin.close()
        assert "left" in terminal.left()


@pytest.mark.slow
def test_terminal_outlives_its_module(standing: Robot) -> None:
    starts(standing)
    with attached(standing) as terminal:
        for start in range(3):
            terminal.until("(Pdb) ")
            kill(standing.top()["bumper"]["pid"])
            standing.until(lambda top, start=start: top["bumper"]["restarts"] == start + 1)  # type: ignore[misc]
        terminal.until("(Pdb) ")
        assert terminal.asked("p self.seen % 5, found") == "(0, 42)\n(Pdb) "


@pytest.mark.slow
def test_terminal_that_does_not_read_holds_nobody_up(standing: Robot) -> None:
    starts(standing)
    with attached(standing) as terminal:
        terminal.until("(Pdb) ")
        terminal.type("print('x' * 50_000_000)")
        terminal.process.send_signal(signal.SIGSTOP)
        assert ends(standing).exit_code == 0


@pytest.mark.slow
def test_second_terminal_and_wrong_names_are_refused_in_a_line(standing: Robot) -> None:
    starts(standing)
    with attached(standing) as terminal:
        terminal.until("(Pdb) ")
        for name, said in {
            "bumper": f"bumper has a terminal already: that of process {terminal.process.pid}",
            "bumpr": "no module is named 'bumpr'; did you mean 'bumper'?",
            "core": "the core has no breakpoints; attach a module",
        }.items():
            refused = standing.command("attach", name)
            assert (refused.returncode, refused.stderr) == (1, f"{said}\n")


@pytest.mark.slow
def test_breakpoint_in_setup_outlasts_the_start_deadline(standing: Robot) -> None:
    standing.write_profile(PROFILE.replace("start_deadline_s: 20", "start_deadline_s: 1"))
    standing.start("--set", "bumper.stands_in=setup")
    wait_until(lambda: bool(standing.top()) and STANDS in standing.log("bumper"))
    with attached(standing) as terminal:
        terminal.until("(Pdb) ")
        time.sleep(1.5)
        terminal.type("c")
        standing.until(lambda top: top["bumper"]["state"] == "RUNNING" and top["bumper"]["restarts"] == 0)


@pytest.mark.slow
def test_module_goes_on_when_nobody_attaches(standing: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    soon = "from robbie_mp.run.supervisor import debugging; debugging.WAIT_S = 0.5"
    python, option, code = COMMAND
    monkeypatch.setattr(robots, "COMMAND", [python, option, f"{soon}; {code}"])
    standing.start("--set", "bumper.hangs_from=0")
    wait_until(lambda: seen(standing) > 100)
    said = standing.log("bumper")
    assert "goes on: nobody was attached for 0.5 s; its breakpoints are passed until you call" in said
    assert said.count(STANDS) == 1
    with attached(standing) as terminal:
        terminal.until("(Pdb) ")


@pytest.mark.slow
def test_variable_of_python_decides_what_a_breakpoint_does(
    standing: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONBREAKPOINT", "0")
    standing.start()
    wait_until(lambda: seen(standing) > 20)
    assert STANDS not in standing.log("bumper")


@pytest.mark.slow
def test_line_that_is_being_typed_gives_way_when_the_module_dies(standing: Robot) -> None:
    starts(standing)
    ours, theirs = os.openpty()
    with subprocess.Popen(
        [*COMMAND, "attach", "bumper"], cwd=standing.folder, stdin=theirs, stdout=theirs, stderr=theirs
    ) as process:
        os.close(theirs)
        try:
            shown = read_until(ours, b"(Pdb) ")
            os.write(ours, b"p 1")
            kill(standing.top()["bumper"]["pid"])
            shown = read_until(ours, b"(Pdb) ")
            assert b"bumper is STARTING (start 2)" in shown, shown
            os.write(ours, b"p self.seen + 900\n")
            assert b"9" in read_until(ours, b"\n(Pdb) ").partition(b"\n")[2]
            os.write(ours, b"\x04")
            assert process.wait(20) == 0
        finally:
            process.kill()
            os.close(ours)


def read_until(fd: int, text: bytes) -> bytes:
    shown = b""
    while not shown.endswith(text):
        assert select.select([fd], [], [], LIMIT_S)[0], shown
        shown += os.read(fd, 1000)
    return shown
