"""The folder of a run: it says that the run exists, who supervises it, and whether that one still lives.

`$XDG_RUNTIME_DIR/robbie/RUNID`, or `/tmp/robbie-UID/RUNID` where there is no such directory. The supervisor
holds a lock (flock(2)) on the folder itself for as long as it lives; the kernel drops it with the process. A
folder appears under its name only when it is locked already, so one that is not locked belongs to a dead run.
The lock also keeps systemd-tmpfiles from clearing the folder away under a robot that runs for weeks.

A run's segments lie in the folder `robbie-RUNID` of /dev/shm, which is made together with this one; the names
of its semaphores start with `sem.robbie-RUNID.`.
"""

import contextlib
import fcntl
import json
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from robbie_mp.errors import RobbieError
from robbie_mp.linux.private_files import ownership_problem, write_private
from robbie_mp.linux.proc import ProcessIdentity
from robbie_mp.trace.disk_writer import DiskWriter
from robbie_mp.transport.shared_folder import NamesTaken, make_folder, remove_names

RUN_ID = re.compile(r"[0-9a-f]{8}")
UNFINISHED_PREFIX = "new-"
MAX_TRIES = 100
"""Run ids of 32 random bits that may be taken."""
RECORD_NAME = "run.json"
PROFILE_FILE = "profile.yaml"
"""The profile as merged, for who records the run."""


class UnsafeRunFolder(RobbieError, PermissionError):
    """The folder for runs could be changed by somebody else, or is none.

    Example scenarios:
      - another user made /tmp/robbie-1000 first, to see or replace what is written there
      - its mode lets a group write
    """


@dataclass(frozen=True)
class RunRecord:
    """What `run.json` says."""

    run_id: str
    profile: str
    supervisor_pid: int
    supervisor_start_ticks: int
    started_at: str
    """ISO 8601, UTC."""
    python: str
    output_directory: str


@dataclass(frozen=True)
class KnownRun:
    """A run that has a folder."""

    run_id: str
    folder: Path
    is_live: bool
    record: RunRecord | None
    """None if its supervisor died before it could write it."""


class RunDirectory:
    """The folder of the run that this process supervises.

    Attributes:
        run_id: eight hexadecimal digits.
        folder: for whatever belongs to the run and ends with it, such as a control socket.
        record: what was written to run.json.
    """

    def __init__(self, folder: Path, record: RunRecord, lock_fd: int):
        self.run_id = record.run_id
        self.folder = folder
        self.record = record
        self._lock_fd = lock_fd

    @classmethod
    def create(cls, profile_name: str, output_directory: Path, base: Path | None = None) -> Self:
        """Make a new run's folder and lock it until `remove`, or until this process dies.

        Raises:
            UnsafeRunFolder: the folder for all runs is not ours alone.
            NamesTaken: somebody has taken every name that was tried.
        """
        base = base_folders()[0] if base is None else base
        _make_private(base)
        run_id = _reserve_run_id(base)
        supervisor = ProcessIdentity.own()
        record = RunRecord(
            run_id=run_id,
            profile=profile_name,
            supervisor_pid=supervisor.pid,
            supervisor_start_ticks=supervisor.start_ticks,
            started_at=datetime.now(UTC).isoformat(),
            python=sys.executable,
            output_directory=str(output_directory.absolute()),
        )
        with contextlib.ExitStack() as undo:
            undo.callback(remove_names, run_id)
            unfinished = base / f"{UNFINISHED_PREFIX}{run_id}"
            unfinished.mkdir(mode=0o700)
            lock_fd = lock_folder(unfinished)
            if lock_fd is None:
                raise BlockingIOError(f"{unfinished} was locked by another process as soon as it was made")
            undo.callback(os.close, lock_fd)
            write_private(unfinished / RECORD_NAME, json.dumps(asdict(record), indent=2) + "\n")
            unfinished.rename(base / run_id)
            undo.pop_all()
        return cls(base / run_id, record, lock_fd)

    def remove(self, disk: DiskWriter | None = None) -> None:
        """Remove the folder with what is left of the run in shared memory, then unlock it.

        Args:
            disk: what removes it; what it leaves on a stalled disk is removed by the next sweep. None: we do.
        """
        remove_names(self.run_id)
        if disk:
            disk.order(["remove", str(self.folder)], b"")
            disk.flush()
        else:
            shutil.rmtree(self.folder, ignore_errors=True)
        os.close(self._lock_fd)


def base_folders() -> list[Path]:
    """Return the folders that may hold runs of this user; new ones go to the first."""
    folders = [Path(f"/tmp/robbie-{os.geteuid()}")]
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    # Under sudo the variable may still name the other user's directory, which is not ours to write to.
    # In one that others can write to, they could put a folder of theirs in the place of ours.
    if runtime and os.path.exists(runtime) and not _parent_problem(runtime):
        folders.insert(0, Path(runtime) / "robbie")
    return folders


def _parent_problem(folder: str) -> str:
    return ownership_problem(os.stat(folder), folder=True, readable=True)


def safe_folders() -> list[Path]:
    """Return those of `base_folders` that exist and that nobody else can have put anything into."""
    return [base for base in base_folders() if os.path.lexists(base) and not privacy_problem(base)]


def list_runs(bases: list[Path] | None = None) -> list[KnownRun]:
    """Return the runs of this user that have a folder, live and dead, oldest first."""
    runs = []
    for folder in _run_folders(safe_folders() if bases is None else bases):
        lock_fd = lock_folder(folder, shared=True)
        if lock_fd is not None:
            os.close(lock_fd)
        if folder.exists():
            runs.append(KnownRun(folder.name, folder, lock_fd is None, read_record(folder)))
    return sorted(runs, key=lambda run: run.record.started_at if run.record else "")


def is_live(folder: Path) -> bool:
    """Whether the supervisor of a run lives."""
    lock_fd = lock_folder(folder, shared=True)
    if lock_fd is not None:
        os.close(lock_fd)
    return lock_fd is None and folder.exists()


def lock_folder(folder: Path, *, shared: bool = False) -> int | None:
    """Lock a folder and return the descriptor that holds the lock; None if it is gone or locked already."""
    try:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(fd)
        return None
    return fd


def read_record(folder: Path) -> RunRecord | None:
    """Return what a run's folder says of it; None if that is missing or damaged."""
    try:
        return RunRecord(**json.loads((folder / RECORD_NAME).read_text()))
    except (OSError, ValueError, TypeError):
        return None


def _run_folders(bases: list[Path]) -> Iterator[Path]:
    for base in bases:
        with contextlib.suppress(FileNotFoundError):
            yield from sorted(path for path in base.iterdir() if RUN_ID.fullmatch(path.name))


def _reserve_run_id(base: Path) -> str:
    """Find a run id that nobody has, and make the folder of its shared memory, so that nobody can take it."""
    for _ in range(MAX_TRIES):
        run_id = secrets.token_hex(4)
        if not (base / run_id).exists():
            with contextlib.suppress(FileExistsError):
                make_folder(run_id)
                return run_id
    raise NamesTaken(f"all {MAX_TRIES} run ids that were tried are taken, such as {run_id}")


def privacy_problem(base: Path) -> str:
    """Return why a folder is not safe to hold runs, '' if it is.

    Raises:
        FileNotFoundError: there is no such folder.
    """
    return ownership_problem(os.lstat(base), folder=True)


def _make_private(base: Path) -> None:
    with contextlib.suppress(FileExistsError):
        base.mkdir(mode=0o700)
    if problem := privacy_problem(base):
        raise UnsafeRunFolder(f"the folder for runs {base} {problem}; remove it or set XDG_RUNTIME_DIR")
