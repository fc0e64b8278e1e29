"""Finds what a block of a test left behind: processes, threads, descriptors and names in shared memory."""

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import psutil

from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY

GRACE_S = 2.0


@contextmanager
def leaving_nothing_behind() -> Iterator[None]:
    """Fail a block that leaves a process, a thread, a descriptor or a name in shared memory."""
    before = Holdings()
    yield
    deadline = time.monotonic() + GRACE_S
    after = Holdings()
    while (extra := after.beyond(before)) and time.monotonic() < deadline:
        time.sleep(0.01)  # let processes that are just ending end; this waits for a condition
        after = Holdings()
    for process in _children() - before.processes:
        process.kill()
    assert not extra, f"left behind: {extra}"


class Holdings:
    """The children, threads, names in shared memory and descriptors that exist now."""

    def __init__(self) -> None:
        self.processes = _children()
        self.threads = {one for one in threading.enumerate() if not one.name.startswith("pytest_timeout")}
        self.names = set(_shared_names())
        self.descriptors = {(fd, _target(fd)) for fd in os.listdir("/proc/self/fd")}

    def beyond(self, before: "Holdings") -> dict[str, list[str]]:
        """Return what exists beyond what did before, by kind."""
        extra = {
            "process": [str(one) for one in self.processes - before.processes],
            "thread": [str(one) for one in self.threads - before.threads],
            "shared memory": sorted(self.names - before.names),
            "descriptor": [
                f"{fd} of {target}"
                for fd, target in self.descriptors - before.descriptors
                if target != "closed" and "/proc/" not in target
            ],
        }
        return {kind: found for kind, found in extra.items() if found}


def _shared_names() -> Iterator[str]:
    """The session's names in shared memory: folders, and the segments in the folders."""
    for name in os.listdir(SHARED_MEMORY):
        yield name
        with contextlib.suppress(OSError):
            yield from (f"{name}/{inner}" for inner in os.listdir(SHARED_MEMORY / name))


def _children() -> set[psutil.Process]:
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return set()  # there are none, so there is no need to read the whole process table
    return set(psutil.Process().children(recursive=True))


def _target(fd: str) -> str:
    try:
        return os.readlink(f"/proc/self/fd/{fd}")
    except OSError:
        return "closed"
