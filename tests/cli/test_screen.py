"""A stopped or closed terminal does not affect the robot."""

import fcntl
import os
import pty
import struct
import termios
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.text import Text

import robbie_mp.module.loop
from robbie_mp.cli.screen import QUEUED_LINES, RunScreen
from robbie_mp.run.operator_link import write_link
from robbie_mp.run.supervisor.states import ChildState, StateChange
from robbie_mp.run.supervisor.supervised_child import BY_ITSELF
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind

LINES = QUEUED_LINES + 3000
LONG = "x" * 200
"""A number of lines that exceeds the buffer of a pipe or terminal without a reader."""


def line(text: str) -> Entry:
    return Entry(1, 0.0, Kind.INFO, "laser", 1, "stdout", text)


def failure(reason: str) -> StateChange:
    return StateChange(
        "laser", 1, ChildState.RUNNING, ChildState.FAILED, reason, 0.0, last_lines=("Traceback", "boom")
    )


def read_all(fd: int) -> str:
    with os.fdopen(fd, "rb") as file:
        return file.read().decode()


def test_lines_are_printed_in_order(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    with RunScreen(quiet=False, fd=writer) as screen:
        for number in range(100):
            screen.listener.entry(line(str(number)))
        screen.listener.change(failure("exit code 1"))
    os.close(writer)
    assert read_all(reader).splitlines() == [
        *(f"[laser] {number}" for number in range(100)),
        "laser: FAILED (exit code 1)",
    ]
    assert screen.dropped == 0


def test_module_that_comes_back_is_named_once() -> None:
    reader, writer = os.pipe()
    with RunScreen(quiet=False, fd=writer) as screen:
        for new, start in ((ChildState.RUNNING, 1), (ChildState.BACKOFF, 1), (ChildState.RUNNING, 2)):
            screen.listener.change(StateChange("laser", start, None, new, "killed by SIGKILL", 0.0))
    os.close(writer)
    shown = read_all(reader).splitlines()
    assert shown == ["laser: BACKOFF (killed by SIGKILL)", "laser: RUNNING again (start 2)"]


def test_quiet_screen_shows_only_failures() -> None:
    reader, writer = os.pipe()
    with RunScreen(quiet=True, fd=writer) as screen:
        screen.listener.entry(line("hello"))
        screen.listener.change(failure("exit code 1"))
    os.close(writer)
    shown = read_all(reader).splitlines()
    assert shown == ["laser: FAILED (exit code 1)", "[laser] Traceback", "[laser] boom"]


def test_run_begins_with_its_heading() -> None:
    reader, writer = os.pipe()
    with RunScreen(quiet=False, heading="robot: 3 modules", fd=writer) as screen:
        screen.listener.begin("1f0c")
        screen.listener.entry(line("hello"))
    os.close(writer)
    assert read_all(reader).splitlines() == ["robot: 3 modules", "[laser] hello"]


@pytest.mark.parametrize("is_blocking", [True, False], ids=["blocking", "non-blocking"])
def test_blocked_reader_blocks_nothing_and_missing_lines_are_counted(is_blocking: bool) -> None:
    """Where another program had made the terminal non-blocking, the run showed nothing more."""
    reader, writer = os.pipe()
    os.set_blocking(writer, is_blocking)
    begin_s = time.monotonic()
    with RunScreen(quiet=False, fd=writer) as screen:
        for _ in range(LINES):
            screen.listener.entry(line(LONG))
        lines_s = time.monotonic() - begin_s
    assert lines_s < 1.0, "the supervisor waited for the terminal"
    assert screen.dropped > 1000
    assert screen._thread.is_alive(), "it should still be waiting for the reader"
    os.set_blocking(reader, True)
    shown = ""
    while f"({screen.dropped} lines not shown" not in shown:
        shown = shown[-1000:] + os.read(reader, 1 << 16).decode()
    os.close(reader)
    screen._thread.join(5.0)
    os.close(writer)
    assert not screen._thread.is_alive()


def running(name: str) -> StateChange:
    return StateChange(name, 1, ChildState.STARTING, ChildState.RUNNING, "ready", 0.0)


@pytest.mark.parametrize("is_terminal", [True, False])
def test_link_with_its_token_is_printed_only_to_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_terminal: bool
) -> None:
    link = "http://127.0.0.1:8080/login?token=a-secret"
    run = SimpleNamespace(run_id="1f0c", folder=tmp_path)
    monkeypatch.setattr("robbie_mp.cli.screen.list_runs", lambda: [run])
    reader, writer = pty.openpty() if is_terminal else os.pipe()
    with RunScreen(quiet=True, fd=writer) as screen:
        screen.listener.begin("1f0c")
        screen.listener.change(running("laser"))
        write_link(tmp_path, link)
        screen.listener.change(running("operator"))
        screen.listener.change(running("mapping"))
    os.write(writer, b"the end")
    shown = ""
    while "the end" not in shown:
        shown += os.read(reader, 1 << 16).decode()
    os.close(reader)
    os.close(writer)
    assert shown.count(link) == int(is_terminal)
    assert shown.count("robbie gui --link") == int(not is_terminal)


def test_live_table_leaves_room_for_the_echo_of_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    observer = SimpleNamespace(modules=list, close=lambda: None)
    monkeypatch.setattr(RunScreen, "_observe", lambda _self: observer)
    monkeypatch.setattr("robbie_mp.cli.screen.table", lambda *_, **_columns: Text("#" * 500))
    controller, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    with RunScreen(quiet=False, fd=terminal):
        shown = ""
        while "#\r\n" not in shown:
            shown += os.read(controller, 1 << 16).decode()
    os.close(controller)
    os.close(terminal)
    assert "#" * 78 in shown
    assert "#" * 79 not in shown


def test_stopped_terminal_does_not_delay_the_end_of_the_run() -> None:
    controller, terminal = pty.openpty()
    begin_s = time.monotonic()
    with RunScreen(quiet=False, fd=terminal) as screen:
        for _ in range(LINES):
            screen.listener.entry(line(LONG))
    assert time.monotonic() - begin_s < 5.0
    os.close(controller)  # the thread is told that its terminal is gone
    screen._thread.join(5.0)
    os.close(terminal)
    assert not screen._thread.is_alive()


def test_closed_pipe_ends_only_the_output() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with RunScreen(quiet=False, fd=writer) as screen:
        for _ in range(LINES):
            screen.listener.entry(line(LONG))
    os.close(writer)
    assert not screen._thread.is_alive()


def test_dump_of_a_hung_module_is_shown_without_our_frames() -> None:
    theirs = '  File "/home/robot/modules/laser.py", line 6 in setup'
    dump = [
        "Fatal Python error: Aborted",
        "Current thread 0x00007fe4c87dfb80 (most recent call first):",
        theirs,
        f'  File "{robbie_mp.module.loop.__file__}", line 60 in set_up',
        '  File "<frozen runpy>", line 88 in _run_code',
        "Extension modules: msgspec._core, numpy._core._multiarray_umath (total: 2)",
    ]
    reader, writer = os.pipe()
    with RunScreen(quiet=False, fd=writer) as screen:
        for text in dump:
            screen.listener.entry(Entry(1, 0.0, Kind.WARNING, "laser", 1, "stderr", text))
    os.close(writer)
    assert read_all(reader).splitlines() == [f"[laser] {dump[1]}", f"[laser] {theirs}"]


def test_module_that_ends_by_itself_is_named() -> None:
    reader, writer = os.pipe()
    with RunScreen(quiet=False, fd=writer) as screen:
        for reason in ("exit code 0", f"exit code 0: {BY_ITSELF}"):
            screen.listener.change(
                StateChange("laser", 1, ChildState.RUNNING, ChildState.STOPPED, reason, 0.0)
            )
    os.close(writer)
    assert read_all(reader) == (
        "laser: STOPPED (exit code 0: it ended by itself, and is not started again)\n"
    )
