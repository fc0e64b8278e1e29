"""Gives this test session a folder of its own in /dev/shm, so that it sees no shared memory but its own.

Import this before robbie_mp. The processes that tests start inherit the variable. The session holds a lock
(flock) on its folder, which another one removes when the lock is gone.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
from pathlib import Path

VARIABLE = "ROBBIE_SHARED_MEMORY"
EVERYBODYS = Path("/dev/shm")
PREFIX = "robbie-tests-"
AS_THE_SYSTEMS = 0o1777
"""The mode of /dev/shm: tests for security look at what other users can do there."""


def make() -> Path:
    """Make the session's folder, which `remove` removes, and let robbie use it."""
    remove_those_of_dead_sessions()
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=EVERYBODYS))
    fcntl.flock(os.open(folder, os.O_RDONLY | os.O_CLOEXEC), fcntl.LOCK_EX)  # open until this process ends
    folder.chmod(AS_THE_SYSTEMS)
    os.environ[VARIABLE] = str(folder)
    return folder


def remove(folder: Path) -> None:
    """Remove a session's folder with all that is in it."""
    shutil.rmtree(folder, ignore_errors=True)


def remove_those_of_dead_sessions() -> None:
    """Remove the folders of sessions whose process was killed."""
    for folder in EVERYBODYS.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # it is locked, or another user's
            _remove_unlocked(folder)


def _remove_unlocked(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(fd).st_mode & 0o7777 == AS_THE_SYSTEMS:  # otherwise it is not locked yet
            remove(folder)
    finally:
        os.close(fd)
