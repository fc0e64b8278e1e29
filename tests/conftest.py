"""Fixtures for all tests; the first one fails any test that leaves something behind."""

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from robbie_mp.transport.layout import HEADER_CREATOR_PID
from tools.loop_disk import LoopDisk, NoLoopDisk

SHARED_MEMORY = Path("/dev/shm")
GRACE_S = 2.0


def _left_behind() -> dict[str, set[object]]:
    """What of ours exists now: children, threads, and names in shared memory (segments and semaphores)."""
    return {
        "process": _children(),
        "thread": {one for one in threading.enumerate() if not one.name.startswith("pytest_timeout")},
        "/dev/shm entry": set(_shared_names()),
        "descriptor": {(fd, _target(fd)) for fd in os.listdir("/proc/self/fd")} - {None},
    }


def _shared_names() -> Iterator[str]:
    """Names in /dev/shm: semaphores, folders, and the segments in the folders of ours."""
    for path in SHARED_MEMORY.iterdir():
        if "robbie" in path.name:
            yield path.name
            with contextlib.suppress(OSError):
                yield from (f"{path.name}/{name}" for name in os.listdir(path))


def _children() -> set[object]:
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return set()  # there are none, which is known without looking at all processes of the machine
    return set(psutil.Process().children(recursive=True))


def _target(fd: str) -> str:
    try:
        return os.readlink(f"/proc/self/fd/{fd}")
    except OSError:
        return "closed"


def _extra(before: dict[str, set[object]]) -> dict[str, set[object]]:
    now = _left_behind()
    extra = {kind: now[kind] - before[kind] for kind in before}
    extra["descriptor"] = {
        (fd, target) for fd, target in extra["descriptor"] if target != "closed" and "/proc/" not in target
    }
    extra["/dev/shm entry"] = {name for name in extra["/dev/shm entry"] if not _is_of_another_run(name)}
    return {kind: items for kind, items in extra.items() if items}


def _is_of_another_run(name: str) -> bool:
    """Whether a name belongs to a robot that somebody else runs on this machine at the same time."""
    run_id = name.partition("/")[0].removeprefix("sem.").split("-")[1].partition(".")[0]
    try:
        board = (SHARED_MEMORY / f"robbie-{run_id}" / "board").read_bytes()
        pid = int.from_bytes(board[8 * HEADER_CREATOR_PID :][:8], "little")
        family = {pid, *(parent.pid for parent in psutil.Process(pid).parents())}
    except (OSError, psutil.NoSuchProcess):
        return False
    return os.getpid() not in family


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a test that tries many cases try all of them."""
    parser.addoption("--exhaustive", action="store_true", help="all kill points, 2,000 cuts of a log")


@pytest.fixture(autouse=True, scope="session")
def bytecode_is_kept(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let the many interpreters that tests start find compiled code, wherever nobody may write any."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        patch.setenv("PYTHONPYCACHEPREFIX", str(tmp_path_factory.mktemp("bytecode")))
        yield


@pytest.fixture
def disk() -> Iterator[LoopDisk]:
    """A disk that may be frozen; whoever writes to it then cannot even be killed."""
    try:
        made = LoopDisk().__enter__()
    except NoLoopDisk as error:
        pytest.skip(f"NOT TESTED, no disk can be frozen here: {error}")
    try:
        yield made
    finally:
        made.__exit__(None, None, None)


@pytest.fixture(autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """Fail a test that leaves a process, a thread, a descriptor or a name in shared memory."""
    with leaving_nothing_behind():
        yield


@contextmanager
def leaving_nothing_behind() -> Iterator[None]:
    """Fail what leaves a process, a thread, a descriptor or a name in shared memory."""
    before = _left_behind()
    yield
    deadline = time.monotonic() + GRACE_S
    while (extra := _extra(before)) and time.monotonic() < deadline:
        time.sleep(0.01)  # what is just ending may end; this waits for a condition, not for an effect
    for process in extra.get("process", ()):
        process.kill()
    assert not extra, f"left behind: {extra}"
