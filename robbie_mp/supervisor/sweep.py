"""Removes what dead runs left: processes, names in shared memory, folders.

Sweeps are safe at any time, also several at once. A folder is swept only under its lock, which a live
supervisor or another sweep would hold. Removing something that is already gone is not an error.
"""

import contextlib
import errno
import os
import re
import shutil
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.linux.private_files import ownership_problem
from robbie_mp.linux.proc import ProcessIdentity
from robbie_mp.run.run_directory import RUN_ID, UNFINISHED_PREFIX, lock_folder, safe_folders
from robbie_mp.supervisor.leftovers import kill_run_leftovers
from robbie_mp.transport import names
from robbie_mp.transport.segment import read_creator
from robbie_mp.transport.shared_folder import (
    SHARED_MEMORY,
    ForeignMemory,
    is_own,
    opened_folder,
    remove_names,
)

SHARED_NAME = re.compile(rf"(?:sem\.)?robbie-({RUN_ID.pattern})(?:\.[0-9a-f]{{16}})?")
UNCLAIMED_AGE_S = 60.0
"""A run without folder and board may be starting while its names are younger than this, on a busy machine."""
UNFINISHED_AGE_S = 60.0
SHORTAGES = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)


@dataclass(frozen=True)
class Swept:
    """The things that a sweep removed. All fields are empty if it found nothing."""

    runs: tuple[str, ...] = ()
    """Run ids."""
    names: tuple[str, ...] = ()
    """Entries of /dev/shm."""
    processes: tuple[int, ...] = ()
    """Pids of killed processes."""


def sweep(bases: list[Path] | None = None, shared_memory: Path = SHARED_MEMORY) -> Swept:
    """Remove what this user's dead runs left.

    Args:
        bases: the folders that hold runs; None: this user's.
        shared_memory: where named segments and semaphores appear.
    """
    bases = safe_folders() if bases is None else bases
    found = _sweep_folders(bases, shared_memory), *_sweep_unclaimed(bases, shared_memory)
    return Swept(
        runs=tuple(run for part in found for run in part.runs),
        names=tuple(name for part in found for name in part.names),
        processes=tuple(pid for part in found for pid in part.processes),
    )


def _sweep_folders(bases: list[Path], shared_memory: Path) -> Swept:
    runs: list[str] = []
    names: list[str] = []
    killed: list[int] = []
    for folder in (path for base in bases if base.is_dir() for path in sorted(base.iterdir())):
        is_run = RUN_ID.fullmatch(folder.name) is not None
        if not is_run and not _is_abandoned(folder):
            continue
        lock_fd = lock_folder(folder)
        if lock_fd is None:
            continue
        try:
            if is_run and folder.exists():  # otherwise another sweep removed it just before we got the lock
                killed += kill_run_leftovers(folder.name)
                names += remove_names(folder.name, shared_memory)
                runs.append(folder.name)
            shutil.rmtree(folder, ignore_errors=True)
        finally:
            os.close(lock_fd)
    return Swept(tuple(runs), tuple(names), tuple(killed))


def _is_abandoned(folder: Path) -> bool:
    """Whether the supervisor that made this folder died before locking it."""
    if not folder.name.startswith(UNFINISHED_PREFIX):
        return False
    with contextlib.suppress(FileNotFoundError):
        return time.time() - folder.lstat().st_mtime > UNFINISHED_AGE_S
    return False


def unclaimed_runs(bases: list[Path] | None = None, shared_memory: Path = SHARED_MEMORY) -> list[str]:
    """Return dead runs with names but no folder, as after the login session's directory was cleared."""
    bases = safe_folders() if bases is None else bases
    return [
        run_id
        for run_id, paths in _own_names(shared_memory).items()
        if not any((base / run_id).exists() for base in bases) and not _is_live(run_id, paths, shared_memory)
    ]


def _sweep_unclaimed(bases: list[Path], shared_memory: Path) -> list[Swept]:
    swept = []
    for run_id in unclaimed_runs(bases, shared_memory):
        killed = kill_run_leftovers(run_id)
        names = remove_names(run_id, shared_memory)
        if names or killed:  # otherwise the run has ended normally since its names were listed
            swept.append(Swept((run_id,), tuple(names), tuple(killed)))
    return swept


def _own_names(shared_memory: Path) -> dict[str, list[Path]]:
    names: dict[str, list[Path]] = defaultdict(list)
    for path in shared_memory.iterdir():
        match = SHARED_NAME.fullmatch(path.name)
        with contextlib.suppress(FileNotFoundError):
            if match and is_own(path.lstat()):
                names[match[1]].append(path)
    return names


def _is_live(run_id: str, paths: list[Path], shared_memory: Path) -> bool:
    try:
        supervisor = _read_board(run_id, shared_memory)
    except OSError:
        return True  # the board cannot be read now, so nothing says that the supervisor is dead
    if supervisor is not None:
        return supervisor.is_alive
    youngest_s = 0.0
    for path in paths:
        with contextlib.suppress(FileNotFoundError):
            youngest_s = max(youngest_s, path.lstat().st_ctime)
    return time.time() - youngest_s < UNCLAIMED_AGE_S


def _read_board(run_id: str, shared_memory: Path) -> ProcessIdentity | None:
    """Return the supervisor named in a board's header; None if we own no such board or it has no header.

    Raises:
        OSError: this process or the machine has no free descriptor or no memory.
    """
    folder, _, file = names.board(run_id).partition("/")
    try:
        with opened_folder(folder, shared_memory) as folder_fd:
            fd = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder_fd)
    except (OSError, ForeignMemory) as error:
        if isinstance(error, OSError) and error.errno in SHORTAGES:
            raise
        return None
    try:
        if ownership_problem(os.fstat(fd)):
            return None
        return read_creator(fd)
    finally:
        os.close(fd)
