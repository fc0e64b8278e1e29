"""The check for leftovers fails the test that leaves something behind, and no other test."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names
from tests._support import own_memory
from tests._support.left_behind import leaving_nothing_behind
from tests._support.places import PROJECT

RUN = "1ef7be41"
MAKE_A_RUN = f"from robbie_mp.bus.transport.shared_folder import make_folder; make_folder({RUN!r})"


@pytest.fixture(autouse=True)
def shorter_grace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests._support.left_behind.GRACE_S", 0.2)


def test_run_left_by_a_process_that_has_ended_is_found() -> None:
    with contextlib.ExitStack() as stack, pytest.raises(AssertionError, match=RUN), leaving_nothing_behind():
        subprocess.run([sys.executable, "-c", MAKE_A_RUN], cwd=PROJECT, check=True)
        stack.callback(remove_names, RUN)


def test_memory_of_other_sessions_and_of_the_users_robots_is_not_seen() -> None:
    assert SHARED_MEMORY.parent == own_memory.EVERYBODYS
    with leaving_nothing_behind():
        make_folder(RUN, own_memory.EVERYBODYS)
    remove_names(RUN, own_memory.EVERYBODYS)


def test_name_thread_descriptor_and_child_are_found() -> None:
    over = threading.Event()
    thread = threading.Thread(target=over.wait, name="forgotten thread")
    with (
        contextlib.ExitStack() as stack,
        pytest.raises(AssertionError) as failure,
        leaving_nothing_behind(),
    ):
        make_folder(RUN)
        stack.callback(remove_names, RUN)
        thread.start()
        stack.callback(thread.join)
        stack.callback(over.set)
        stack.callback(os.close, os.open(PROJECT, os.O_RDONLY))
        child = stack.enter_context(subprocess.Popen(["sleep", "60"]))
    assert child.returncode == -signal.SIGKILL, "a forgotten process is not left to the next test"
    found = str(failure.value)
    for what in ("'process'", "forgotten thread", RUN, f"of {PROJECT}"):
        assert what in found


def test_memory_of_a_killed_session_is_removed_and_that_of_a_live_one_stays() -> None:
    program = (
        "import os; from tests._support import own_memory; print(own_memory.make(), flush=True); os.abort()"
    )
    command = [sys.executable, "-c", program]
    killed = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False)
    folder = Path(killed.stdout.strip())
    assert folder.is_dir()
    (folder / "robbie-1234abcd").mkdir()
    own_memory.remove_those_of_dead_sessions()
    assert not folder.exists()
    assert SHARED_MEMORY.is_dir()
