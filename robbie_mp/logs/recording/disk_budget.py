"""Keeps a folder of recordings within a size by removing the oldest parts."""

import contextlib
import fcntl
import os
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from robbie_mp.logs.recording.bag_metadata import update_bag_metadata
from robbie_mp.logs.recording.format import PART_NAME
from robbie_mp.logs.recording.mcap_records import MAGIC

LIBRARY = "robbie-mp"
"""First name in the header of each of our logs; no other file is ever removed."""


class _OldPart(NamedTuple):
    changed_ns: int
    path: Path
    bytes: int


class DiskBudget:
    """Space for recordings in a folder.

    It removes only parts of our own recordings, those that were changed longest ago first, and never a part
    that any process is writing.

    Args:
        folder: holds recordings, each in its own folder.
        bytes: limit for all their parts together; 0: no limit.
    """

    def __init__(self, folder: Path, bytes: int):
        self._folder = folder
        self._bytes = bytes
        self._others: deque[_OldPart] = deque()
        self._others_bytes = 0

    def look(self, own: Path) -> None:
        """Find the other parts, besides the one that will be written."""
        self._others = deque(sorted(part for part in self._parts() if part.path != own))
        self._others_bytes = sum(part.bytes for part in self._others)

    def make_room(self, own_bytes: int) -> list[Path]:
        """Remove old parts until our own part may have this many bytes; return the removed ones."""
        removed: list[Path] = []
        kept: list[_OldPart] = []
        while self._bytes and self._others and self._others_bytes + own_bytes > self._bytes:
            oldest = self._others.popleft()
            if _remove(oldest.path):
                self._others_bytes -= oldest.bytes
                removed.append(oldest.path)
            else:
                kept.append(oldest)
        self._others.extendleft(reversed(kept))
        return removed

    def _parts(self) -> Iterator[_OldPart]:
        for path in self._folder.glob("*/*.mcap"):
            match = PART_NAME.fullmatch(path.name)
            if match and match["name"] == path.parent.name:
                with contextlib.suppress(FileNotFoundError):
                    status = path.stat()
                    yield _OldPart(status.st_mtime_ns, path, status.st_size)


def _remove(path: Path) -> bool:
    """Remove a part, and its folder if it was the last one; False if the part must not be removed."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # refused if a process is writing the part
        if not _is_ours(os.pread(fd, 256, 0)):
            return False
        path.unlink(missing_ok=True)
    except OSError:
        return False
    finally:
        os.close(fd)
    update_bag_metadata(path.parent)
    with contextlib.suppress(OSError):
        path.parent.rmdir()
    return True


def _is_ours(head: bytes) -> bool:
    return head.startswith(MAGIC) and LIBRARY.encode() in head
