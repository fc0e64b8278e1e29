"""Finds the names in /dev/shm that processes have mapped, and removes those that no process has mapped."""

import contextlib
from collections.abc import Iterable
from pathlib import Path

import psutil

FOLDER = "/dev/shm/"


def mapped_names(pids: Iterable[int]) -> set[Path]:
    """Return the names that processes have mapped, including those of semaphores."""
    names = set()
    for pid in pids:
        with contextlib.suppress(OSError):  # the process has ended, or belongs to another user
            for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
                _, found, name = line.partition(FOLDER)
                if found:
                    names.add(Path(FOLDER + name.removesuffix(" (deleted)")))
    return names


def remove_unmapped(names: Iterable[Path]) -> None:
    """Remove those of the names that no process has mapped."""
    for name in set(names) - mapped_names(psutil.pids()):
        name.unlink(missing_ok=True)
