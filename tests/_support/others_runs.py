"""Distinguishes the runs of this test session from others on the machine, by their names in /dev/shm.

A run belongs to the process that made it. A process belongs to a session if it descends from it, or if it
started with `VARIABLE` set to the session's mark, which orphans keep. An owner can be identified only while
it lives. So each session has a process that checks all runs from time to time and records those of others. It
is not a child of the session, because tests count children. A run with an unknown owner counts as the
session's.
"""

import contextlib
import os
import re
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from robbie_mp.base.linux.proc import ProcessIdentity, environment_value, read_stat
from robbie_mp.bus.transport.layout import HEADER_CREATOR_PID, HEADER_CREATOR_START, HEADER_WORDS
from robbie_mp.bus.transport.shared_folder import remove_names
from robbie_mp.run.run_directory import RUN_ID
from robbie_mp.run.supervisor.leftovers import MARKER
from tests._support.own_runs import VARIABLE
from tests._support.places import PROJECT

SHARED_MEMORY = Path("/dev/shm")
LOOK_PERIOD_S = 0.05
UNIT_TEST_RUN = re.compile(rf"(?!{RUN_ID.pattern}$)[a-z]+([0-9]+)(?:x[0-9]+)?")
"""What unit tests call their memory: after their process, with a number if it makes several.

A run's random id may look the same, such as "abc12345". It is not one of these.
"""


@dataclass(frozen=True)
class Session:
    """A process that runs tests, and the mark in the environment of the processes that it starts."""

    pid: int
    mark: str

    def owns(self, pid: int) -> bool | None:
        """Whether a process is of this session; None if it has ended."""
        try:
            environment = Path(f"/proc/{pid}/environ").read_bytes()
            family = {pid, *(parent.pid for parent in psutil.Process(pid).parents())}
        except PermissionError:
            return False  # another user's
        except (OSError, psutil.NoSuchProcess):
            return None
        if self.pid in family or f"{VARIABLE}={self.mark}".encode() in environment.split(b"\0"):
            return True
        return False if environment else None  # a process that is ending no longer has one

    def owns_run(self, run_id: str) -> bool | None:
        """Whether the process that made a run is of this session; None if no such process lives."""
        try:
            header = (SHARED_MEMORY / f"robbie-{run_id}" / "board").read_bytes()[: HEADER_WORDS * 8]
            words = struct.unpack(f"<{HEADER_WORDS}Q", header)
        except (OSError, struct.error):
            return None
        owner = ProcessIdentity(words[HEADER_CREATOR_PID], words[HEADER_CREATOR_START])
        return self.owns(owner.pid) if owner.is_alive else None

    def is_named_after_others(self, run_id: str) -> bool:
        """Whether a unit test of others made this memory: they name it after their process."""
        named = UNIT_TEST_RUN.fullmatch(run_id)
        return named is not None and self.owns(int(named[1])) is False

    def is_mapped_by_others(self, run_id: str) -> bool:
        """Whether others, and nobody of this session, use memory that has no supervisor, as unit tests do.

        A module's process proves nothing: the environment of one that we lost does not have our mark.
        """
        users = _users(run_id)
        return bool(users) and all(
            self.owns(pid) is False and environment_value(pid, MARKER) is None for pid in users
        )


class OthersRuns:
    """The runs of others, as far as a session knows them.

    Attributes:
        session: whose runs they are not.
        seen: the file into which `watch` writes them.
    """

    def __init__(self, session: Session, seen: Path) -> None:
        self.session = session
        self.seen = seen

    def among(self, run_ids: set[str]) -> set[str]:
        """Return which of these runs are others'."""
        seen = set(self.seen.read_text().split())
        asked = {
            run_id
            for run_id in run_ids - seen
            if self.session.owns_run(run_id) is False
            or self.session.is_named_after_others(run_id)
            or self.session.is_mapped_by_others(run_id)
        }
        return asked | (run_ids & seen)


def remove_names_of_dead_tests() -> list[str]:
    """Remove what unit tests left in /dev/shm whose process was killed; return the names.

    Such a test has no supervisor, and no run can have its id, so no `robbie run` removes these names.
    """
    removed = []
    for name in os.listdir(SHARED_MEMORY):
        run_id = run_id_of(name)
        named = UNIT_TEST_RUN.fullmatch(run_id)
        if named and not psutil.pid_exists(int(named[1])):
            removed += remove_names(run_id)
    return removed


@contextmanager
def watched(session: Session, seen: Path) -> Iterator[None]:
    """Record the runs of others in a file, until the session's process ends."""
    seen.touch()
    words = [sys.executable, "-m", __name__, str(session.pid), session.mark, str(seen)]
    with subprocess.Popen(
        ["sh", "-c", '"$@" &', "sh", *words], cwd=PROJECT, stdin=subprocess.DEVNULL
    ) as shell:
        shell.wait()
    yield
    seen.unlink()  # which ends it


def run_ids() -> set[str]:
    """Return the runs that have a name in shared memory."""
    return {run_id_of(name) for name in os.listdir(SHARED_MEMORY) if "robbie-" in name}


def run_id_of(name: str) -> str:
    """Return the run of `robbie-RUN`, `robbie-RUN/SEGMENT` or `robbie-RUN-GUESS`."""
    return re.split(r"[.-]", name.partition("/")[0].removeprefix("robbie-"))[0]


def watch(session: Session, seen: Path) -> None:
    """Record the runs of others until the session's process ends or the file is removed."""
    stat = read_stat(session.pid)
    tests = ProcessIdentity(session.pid, stat.start_ticks if stat else 0)
    judged: set[str] = set()
    while tests.is_alive and seen.exists():
        existing = run_ids()
        judged &= existing
        for run_id in existing - judged:
            is_ours = session.owns_run(run_id)
            if is_ours is not None:
                judged.add(run_id)
            if is_ours is False:
                _add_line(seen, run_id)
        time.sleep(LOOK_PERIOD_S)  # there is no notification of new names, and this is not a test


def _add_line(path: Path, text: str) -> None:
    """Append a line to an existing file with one write."""
    with contextlib.suppress(FileNotFoundError):
        fd = os.open(path, os.O_WRONLY | os.O_APPEND)
        os.write(fd, f"{text}\n".encode())
        os.close(fd)


def _users(run_id: str) -> list[int]:
    folder = f"{SHARED_MEMORY}/robbie-{run_id}/"
    users = []
    for pid in psutil.pids():
        with contextlib.suppress(OSError):
            if folder in Path(f"/proc/{pid}/maps").read_text():
                users.append(pid)
    return users


if __name__ == "__main__":
    watch(Session(int(sys.argv[1]), sys.argv[2]), Path(sys.argv[3]))
