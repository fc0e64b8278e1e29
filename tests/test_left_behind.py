"""The check for leftovers fails the test that leaves something behind, and no other test."""

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Self

import pytest

from robbie_mp.bus.transport.shared_folder import remove_names
from tests._support.others_runs import SHARED_MEMORY, OthersRuns, remove_names_of_dead_tests
from tests._support.own_runs import VARIABLE
from tests._support.places import PROJECT

Check = Callable[[], AbstractContextManager[None]]
LIMIT_S = 20.0
NUMBERS = itertools.count()
MAKE = """
import mmap, sys
from array import array
from robbie_mp.base.linux.proc import ProcessIdentity
from robbie_mp.bus.transport import names, shared_folder
from robbie_mp.bus.transport.layout import HEADER_CREATOR_PID, HEADER_CREATOR_START, HEADER_WORDS
run_id, has_board = sys.argv[1], sys.argv[2] == "board"
sys.stdin.readline()
shared_folder.make_folder(run_id)
words = array("Q", [0] * HEADER_WORDS)
own = ProcessIdentity.own()
words[HEADER_CREATOR_PID], words[HEADER_CREATOR_START] = own.pid, own.start_ticks
path = shared_folder.SHARED_MEMORY / (names.board(run_id) if has_board else names.core(run_id))
path.write_bytes(words)
with open(path, "r+b") as file:
    mapping = mmap.mmap(file.fileno(), 0)
print("made", flush=True)
sys.stdin.read()
"""


class Maker:
    """A process that makes a run's names in shared memory; at the end of the block both are gone."""

    def __init__(self, run_id: str, *, is_orphan: bool, has_mark: bool, has_board: bool = True) -> None:
        self.folder = SHARED_MEMORY / f"robbie-{run_id}"
        words = [sys.executable, "-c", MAKE, run_id, "board" if has_board else ""]
        if is_orphan:  # the shell gives a process in the background its input only when told to
            words = ["sh", "-c", 'exec 3<&0; "$@" <&3 &', "sh", *words]
        environment = {name: text for name, text in os.environ.items() if has_mark or name != VARIABLE}
        self._has_ended = False
        self._process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=PROJECT, env=environment
        )

    def make(self) -> None:
        """Let it make them, and wait until it has."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(b"make\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline() == b"made\n"

    def end(self) -> None:
        """Let it end, and wait until it has closed its output."""
        if not self._has_ended:
            self._has_ended = True
            self._process.communicate(timeout=LIMIT_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()
        for file in self.folder.iterdir():
            file.unlink()
        self.folder.rmdir()


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture(autouse=True)
def shorter_grace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests._support.left_behind.GRACE_S", 0.2)


@pytest.fixture
def run_id() -> str:
    """One that no other test and no other test session uses."""
    return f"{next(NUMBERS):02x}{os.getpid():06x}"


@pytest.mark.parametrize("has_board", [True, False])
@pytest.mark.parametrize(("is_orphan", "has_mark"), [(False, True), (False, False), (True, True)])
@pytest.mark.parametrize("has_ended", [True, False])
def test_run_left_by_a_process_of_this_session_is_found(
    left_behind_check: Check, run_id: str, is_orphan: bool, has_mark: bool, has_board: bool, has_ended: bool
) -> None:
    maker = Maker(run_id, is_orphan=is_orphan, has_mark=has_mark, has_board=has_board)
    with maker, pytest.raises(AssertionError, match=f"robbie-{run_id}/"), left_behind_check():
        maker.make()
        if has_ended:
            maker.end()


@pytest.mark.parametrize("has_board", [True, False])
def test_run_used_by_another_session_is_ignored(
    left_behind_check: Check, run_id: str, has_board: bool
) -> None:
    with Maker(run_id, is_orphan=True, has_mark=False, has_board=has_board) as maker, left_behind_check():
        maker.make()


def test_dead_run_of_another_session_is_ignored(
    left_behind_check: Check, others_runs: OthersRuns, run_id: str
) -> None:
    with Maker(run_id, is_orphan=True, has_mark=False) as maker, left_behind_check():
        maker.make()
        until(lambda: run_id in others_runs.seen.read_text())
        maker.end()


def test_name_thread_descriptor_and_child_are_found(left_behind_check: Check, run_id: str) -> None:
    folder = SHARED_MEMORY / f"robbie-{run_id}"
    over = threading.Event()
    thread = threading.Thread(target=over.wait, name="forgotten thread")
    with contextlib.ExitStack() as stack, pytest.raises(AssertionError) as failure, left_behind_check():
        folder.mkdir()
        stack.callback(folder.rmdir)
        thread.start()
        stack.callback(thread.join)
        stack.callback(over.set)
        stack.callback(os.close, os.open(PROJECT, os.O_RDONLY))
        child = stack.enter_context(subprocess.Popen(["sleep", "60"]))
    assert child.returncode == -signal.SIGKILL, "a forgotten process is not left to the next test"
    found = str(failure.value)
    for what in ("'process'", "forgotten thread", folder.name, f"of {PROJECT}"):
        assert what in found


def test_memory_named_after_a_process_of_others_is_ignored(left_behind_check: Check) -> None:
    """Unit tests make memory without a board, and map nothing of it for a moment."""
    own_letters = "".join(chr(ord("a") + int(digit)) for digit in str(os.getpid()))
    folders = [SHARED_MEMORY / f"robbie-{own_letters}{pid}" for pid in (1, os.getpid())]
    with contextlib.ExitStack() as stack, pytest.raises(AssertionError) as failure, left_behind_check():
        for folder in folders:
            folder.mkdir()
            stack.callback(folder.rmdir)
    assert folders[0].name + "'" not in str(failure.value)
    assert folders[1].name in str(failure.value)


def test_names_of_a_killed_test_are_removed_and_those_of_a_live_one_stay() -> None:
    with subprocess.Popen(["sleep", "60"]) as process:
        process.kill()
    own_letters = "".join(chr(ord("a") + int(digit)) for digit in str(os.getpid()))
    dead, live = f"{own_letters}{process.pid}x3", f"{own_letters}{os.getpid()}"
    folders = [SHARED_MEMORY / f"robbie-{run}" for run in (dead, live)]
    for folder in folders:
        folder.mkdir(mode=0o700)
        (folder / "core").touch()
    removed = remove_names_of_dead_tests()
    assert [folder.exists() for folder in folders] == [False, True]
    assert f"robbie-{dead}" in removed
    remove_names(live)


def test_names_of_a_run_whose_id_looks_like_a_dead_tests_stay() -> None:
    """One in thirty random ids is letters followed by digits, which are hardly ever the pid of a process."""
    folder = next(
        path
        for letters in itertools.product("abcdef", repeat=2)
        if not (path := SHARED_MEMORY / f"robbie-{''.join(letters)}999999").exists()
    )
    folder.mkdir(mode=0o700)
    try:
        remove_names_of_dead_tests()
        assert folder.exists()
    finally:
        remove_names(folder.name.removeprefix("robbie-"))
