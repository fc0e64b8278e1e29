"""Removes what dead runs left: processes, names in shared memory, folders.

Sweeps are safe at any time, also several at once and in several containers. A run is swept only under the
locks of its folders (see `robbie_mp.run.run_directory`), which a live supervisor or another sweep would hold.
Removing something that is already gone is not an error.
"""

import contextlib
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.bus.transport.names import folder as folder_name
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, is_own, remove_names
from robbie_mp.run.run_directory import RUN_ID, UNFINISHED_PREFIX, folders_of, lock_folder, safe_folders
from robbie_mp.run.supervisor.leftovers import kill_run_leftovers

SHARED_NAME = re.compile(rf"robbie-({RUN_ID.pattern})")
UNFINISHED_AGE_S = 60.0


@dataclass(frozen=True)
class Swept:
    """The things that a sweep removed. All fields are empty if it found nothing."""

    runs: tuple[str, ...] = ()
    """Run ids."""
    names: tuple[str, ...] = ()
    """Entries of /dev/shm."""
    processes: tuple[int, ...] = ()
    """Pids of killed processes."""


def sweep(
    bases: list[Path] | None = None,
    shared_memory: Path = SHARED_MEMORY,
    salvage: Callable[[str, Path | None], object] = lambda _run_id, _folder: None,
) -> Swept:
    """Remove what this user's dead runs left.

    Args:
        bases: the folders that hold runs; None: this user's.
        shared_memory: where named segments appear.
        salvage: called with the id and the folder of each dead run before its memory is removed.
    """
    bases = safe_folders() if bases is None else bases
    found = [_sweep_run(run_id, bases, shared_memory, salvage) for run_id in _run_ids(bases, shared_memory)]
    for folder in _folders(bases):
        if _is_abandoned(folder):
            _sweep_unfinished(folder)
    return Swept(
        runs=tuple(run for part in found for run in part.runs),
        names=tuple(name for part in found for name in part.names),
        processes=tuple(pid for part in found for pid in part.processes),
    )


def sweep_base(base: Path, shared_memory: Path = SHARED_MEMORY) -> None:
    """Remove what the dead runs of one folder left, and of no other.

    Args:
        base: the folder that holds the runs; it need not exist.
        shared_memory: where named segments appear.
    """
    for folder in list(base.glob("*")):
        if RUN_ID.fullmatch(folder.name):
            _sweep_run(folder.name, [base], shared_memory, lambda _run_id, _folder: None)


def dead_runs(bases: list[Path] | None = None, shared_memory: Path = SHARED_MEMORY) -> list[str]:
    """Return the ids of dead runs that left something."""
    bases = safe_folders() if bases is None else bases
    dead = []
    for run_id in _run_ids(bases, shared_memory):
        with _locked(run_id, bases, shared_memory) as folders:
            dead += [] if folders is None else [run_id]
    return dead


def _sweep_run(
    run_id: str,
    bases: list[Path],
    shared_memory: Path,
    salvage: Callable[[str, Path | None], object],
) -> Swept:
    with _locked(run_id, bases, shared_memory) as folders:
        if folders is None:
            return Swept()
        killed = kill_run_leftovers(run_id)
        salvage(run_id, folders[0] if folders else None)
        names = remove_names(run_id, shared_memory)
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)
    if not (killed or names or folders):  # it has ended normally, or was swept, since it was listed
        return Swept()
    return Swept((run_id,), tuple(names), tuple(killed))


@contextlib.contextmanager
def _locked(run_id: str, bases: list[Path], shared_memory: Path) -> Iterator[list[Path] | None]:
    """Lock the folders of a dead run; yield those outside shared memory, None if somebody else has a lock."""
    folders, memory = folders_of(run_id, bases, shared_memory), shared_memory / folder_name(run_id)
    with contextlib.ExitStack() as locks:
        is_dead = all(_lock(folder, locks) for folder in [*folders, memory] if os.path.lexists(folder))
        yield [folder for folder in folders if os.path.lexists(folder)] if is_dead else None


def _lock(folder: Path, locks: contextlib.ExitStack) -> bool:
    try:
        lock_fd = lock_folder(folder)
    except OSError:
        return False  # it cannot be opened now, so nothing says that its supervisor is dead
    if lock_fd is not None:
        locks.callback(os.close, lock_fd)
    return lock_fd is not None


def _run_ids(bases: list[Path], shared_memory: Path) -> list[str]:
    """Return the ids of all runs of this user that have a folder or a name in shared memory."""
    shared = []
    for path in shared_memory.iterdir():
        with contextlib.suppress(FileNotFoundError):
            if (match := SHARED_NAME.fullmatch(path.name)) and is_own(path.lstat()):
                shared.append(match[1])
    return sorted({*shared, *(folder.name for folder in _folders(bases) if RUN_ID.fullmatch(folder.name))})


def _folders(bases: list[Path]) -> list[Path]:
    return [path for base in bases if base.is_dir() for path in sorted(base.iterdir())]


def _sweep_unfinished(folder: Path) -> None:
    with contextlib.ExitStack() as locks:
        if _lock(folder, locks):
            shutil.rmtree(folder, ignore_errors=True)


def _is_abandoned(folder: Path) -> bool:
    """Whether the supervisor that made this folder died before locking it."""
    if not folder.name.startswith(UNFINISHED_PREFIX):
        return False
    with contextlib.suppress(FileNotFoundError):
        return time.time() - folder.lstat().st_mtime > UNFINISHED_AGE_S
    return False
