"""Fixtures for all tests; the first one fails any test that leaves something behind."""

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

SHARED_MEMORY = Path("/dev/shm")
GRACE_S = 2.0


def _left_behind() -> dict[str, set[object]]:
    """What of ours exists now: children, threads, and names in shared memory (segments and semaphores)."""
    return {
        "process": set(psutil.Process().children(recursive=True)),
        "thread": set(threading.enumerate()),
        "/dev/shm entry": {path.name for path in SHARED_MEMORY.iterdir() if "robbie" in path.name},
        "descriptor": {(fd, _target(fd)) for fd in os.listdir("/proc/self/fd")} - {None},
    }


def _target(fd: str) -> str:
    try:
        return os.readlink(f"/proc/self/fd/{fd}")
    except OSError:
        return "closed"


def _extra(before: dict[str, set[object]]) -> dict[str, set[object]]:
    now = _left_behind()
    extra = {kind: now[kind] - before[kind] for kind in before}
    extra["descriptor"] = {item for item in extra["descriptor"] if item[1] != "closed" and "/proc/" not in item[1]}
    return {kind: items for kind, items in extra.items() if items}


@pytest.fixture(autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """Fail a test that leaves a process, a thread, a descriptor or a name in shared memory."""
    before = _left_behind()
    yield
    deadline = time.monotonic() + GRACE_S
    while (extra := _extra(before)) and time.monotonic() < deadline:
        time.sleep(0.01)  # what is just ending may end; this waits for a condition, not for an effect
    for process in extra.get("process", ()):
        process.kill()
    assert not extra, f"left behind: {extra}"
