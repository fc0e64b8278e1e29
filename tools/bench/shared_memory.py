"""Names in /dev/shm: who has which, and the removal of those that nobody has."""

import contextlib
from collections.abc import Iterable
from pathlib import Path

import psutil

FOLDER = "/dev/shm/"


def mapped_names(pids: Iterable[int]) -> set[Path]:
    """Return the names that processes have mapped; semaphores are among them."""
    names = set()
    for pid in pids:
        with contextlib.suppress(OSError):  # it has ended, or is somebody else's
            for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
                _, found, name = line.partition(FOLDER)
                if found:
                    names.add(Path(FOLDER + name.removesuffix(" (deleted)")))
    return names


def remove_unmapped(names: Iterable[Path]) -> None:
    """Remove those names that no process has mapped."""
    for name in set(names) - mapped_names(psutil.pids()):
        name.unlink(missing_ok=True)
