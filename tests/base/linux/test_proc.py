"""The children of this process as listed in /proc."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from robbie_mp.base.linux import proc
from robbie_mp.base.linux.proc import own_children, read_usage
from tests.run.supervisor._support.running import is_gone, wait_for

COMMAND = [sys.executable, "-S", "-E", "-c", "import sys; sys.stdin.read()"]


def test_children_of_every_thread_are_listed_even_dead_ones() -> None:
    before = own_children()
    started: list[subprocess.Popen[bytes]] = []
    may_end = threading.Event()

    def start() -> None:
        started.append(subprocess.Popen(COMMAND, stdin=subprocess.PIPE))
        may_end.wait()

    thread = threading.Thread(target=start)
    thread.start()
    wait_for(lambda: bool(started))
    try:
        assert own_children() - before == {started[0].pid}
        started[0].kill()
        wait_for(lambda: is_gone(started[0].pid))
        assert own_children() - before == {started[0].pid}, "a dead one, before it was reaped"
    finally:
        may_end.set()
        thread.join()
        started[0].communicate()
    assert own_children() == before


def test_children_are_found_without_the_kernels_child_lists(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Kernels may be built without CONFIG_PROC_CHILDREN."""

    def refuse(path: str, *arguments: object) -> object:
        if path.endswith("/children"):
            raise FileNotFoundError(path)
        return open(path, *arguments)  # type: ignore[call-overload]

    with subprocess.Popen(COMMAND, stdin=subprocess.PIPE) as process:
        expected = own_children()
        monkeypatch.setattr(proc, "open", refuse, raising=False)
        assert own_children() == expected
        assert process.pid in expected
        assert os.getpid() not in expected
        process.communicate()


def test_no_file_is_left_open() -> None:
    own_children()
    before = set(Path("/proc/self/fd").iterdir())
    own_children()
    assert set(Path("/proc/self/fd").iterdir()) == before


def test_wakeups_of_every_thread_count() -> None:
    def wait_often() -> None:
        for _ in range(50):
            time.sleep(0.001)
        has_waited.set()
        may_end.wait()

    has_waited, may_end = threading.Event(), threading.Event()
    before = read_usage(os.getpid()).wakeups
    thread = threading.Thread(target=wait_often)
    thread.start()
    try:
        has_waited.wait()  # this thread waits once
        assert read_usage(os.getpid()).wakeups >= before + 50
    finally:
        may_end.set()
        thread.join()
