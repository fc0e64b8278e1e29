"""Removes the shared memory of dead FastDDS participants, such as nodes of ROS 2 that were killed.

A participant that ends cleanly removes its files in /dev/shm. One that is killed leaves 0.6 MB, which only
`fastdds shm clean` removes. A live one holds a lock (flock) beside each of its files: FILE_el if it alone
reads there, FILE_sl if others do, too. Version 2 (Jazzy) calls them fastrtps_…, version 3 (Kilted) fastdds_….
"""

import contextlib
import fcntl
import os
import re
import time
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
LOCKS = ("_el", "_sl")
YOUNG_S = 1.0
"""A participant that begins makes a file, and its lock a moment later."""
_FILE = r"(?:fastrtps|fastdds)_(?:port\d+|[0-9a-f]{16})"
_ENTRY = re.compile(rf"(?:sem\.)?({_FILE})(_el|_sl|_mutex)?")
_MAPPED = re.compile(rf"/({_FILE})$", re.MULTILINE)


def remove_dead_participants(shared_memory: Path = SHARED_MEMORY) -> list[str]:
    """Remove what this user's dead participants left; return the names of the files.

    Args:
        shared_memory: where named segments appear.
    """
    entries: dict[str, list[Path]] = {}
    for path in shared_memory.iterdir():
        if match := _ENTRY.fullmatch(path.name):
            entries.setdefault(match[1], []).append(path)
    mapped = _mapped() if entries else set()
    removed: list[str] = []
    for name, paths in entries.items():
        if name not in mapped:
            removed += _remove(paths)
    return removed


def _remove(paths: list[Path]) -> list[str]:
    """Remove a file, its mutex and its locks, unless a participant holds one of these."""
    with contextlib.ExitStack() as held:
        locks = [path for path in paths if path.name.endswith(LOCKS)]
        try:
            found = [path.lstat() for path in paths]
            is_young = not locks and time.time() - max(one.st_mtime for one in found) < YOUNG_S
            if is_young or any(one.st_uid != os.geteuid() for one in found):
                return []
            for lock in locks:
                fd = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
                held.callback(os.close, fd)
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return []  # it lives, or has gone meanwhile
        return [path.name for path in paths if _unlink(path)]


def _unlink(path: Path) -> bool:
    try:
        path.unlink()
    except OSError:
        return False
    return True


def _mapped() -> set[str]:
    """Return the files of FastDDS that a process has mapped: a lock may have been replaced by another one."""
    found: set[str] = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            found.update(_MAPPED.findall(maps.read_text(errors="replace")))
    return found
