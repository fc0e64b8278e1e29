"""The folder of a run. It shows that the run exists, which process supervises it, and whether that is alive.

The folder is `$XDG_RUNTIME_DIR/robbie/RUNID`, or `/tmp/robbie-UID/RUNID` where there is no such directory.
A run's segments are in the folder `robbie-RUNID` of /dev/shm, which is made together with this one.

The supervisor holds a lock (flock(2)) on each of the two folders while it lives; the kernel releases it with
the process. So each folder itself says whether its run is alive, also to a container that sees other
processes, or that shares only one of the two folders. The folder of the run is locked before it gets its
name. The one in /dev/shm is not: if another process removes it just before it is locked, the run takes
another id. So a folder without a lock belongs to a dead run. The lock also keeps systemd-tmpfiles from
removing the folder of a robot that runs for weeks.
"""

import contextlib
import fcntl
import json
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path

import msgspec
from typing_extensions import Self

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import ownership_problem, write_private
from robbie_mp.base.linux.proc import ProcessIdentity
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.shared_folder import (
    SHARED_MEMORY,
    NamesTaken,
    SegmentMismatch,
    SegmentMissing,
    make_folder,
    opened_folder,
    remove_names,
)
from robbie_mp.run.trace.disk_writer import DiskWriter

RUN_ID = re.compile(r"[0-9a-f]{8}")
UNFINISHED_PREFIX = "new-"
MAX_TRIES = 100
"""How many random run ids of 32 bits are tried."""
LOGIN_SESSIONS = Path("/run/user")
"""Where systemd makes the XDG_RUNTIME_DIR of each user who is logged in."""
RECORD_NAME = "run.json"
PROFILE_FILE = "profile.yaml"
"""The merged profile, for recordings of the run."""


class UnsafeRunFolder(RobbieError, PermissionError):
    """Other users could change the folder for runs, or it is not a folder.

    Example scenarios:
      - another user created /tmp/robbie-1000 first, to read or replace the files there
      - its mode allows a group to write
    """


@dataclass(frozen=True)
class RunRecord:
    """The content of `run.json`."""

    run_id: str
    profile: str
    supervisor_pid: int
    supervisor_start_ticks: int
    started_at: str
    """ISO 8601, UTC."""
    python: str
    output_directory: str
    workspace: str
    """The robot's folder."""
    is_robot: bool
    """Whether it was started as the robot of its workspace; not to play a log, or to steer another robot."""


@dataclass(frozen=True)
class KnownRun:
    """A run that has a folder."""

    run_id: str
    folder: Path
    is_live: bool
    record: RunRecord | None
    """None if the supervisor died before it wrote the record."""


class RunDirectory:
    """The folder of the run that this process supervises.

    Attributes:
        run_id: eight hexadecimal digits.
        folder: holds what exists only during the run, such as the control socket.
        record: the content of run.json.
    """

    def __init__(self, folder: Path, record: RunRecord, shared_memory: Path, lock_fds: Sequence[int]):
        self.run_id = record.run_id
        self.folder = folder
        self.record = record
        self._shared_memory = shared_memory
        self._lock_fds = lock_fds

    @classmethod
    def create(
        cls,
        profile_name: str,
        output_directory: Path,
        base: Path | None = None,
        shared_memory: Path = SHARED_MEMORY,
        *,
        workspace: Path = Path(),
        is_robot: bool = False,
    ) -> Self:
        """Make a new run's folders and lock them until `remove` or the end of this process.

        Args:
            profile_name: for the record.
            output_directory: for the record.
            base: the folder for runs; None: the first of `base_folders`.
            shared_memory: where named segments and semaphores appear.
            workspace: for the record.
            is_robot: for the record.

        Raises:
            UnsafeRunFolder: other users could change the folder for runs.
            NamesTaken: every run id that was tried is in use.
        """
        base = base_folders()[0] if base is None else base
        make_private(base)
        run_id, memory_lock_fd = _reserve_run_id(base, shared_memory)
        supervisor = ProcessIdentity.own()
        record = RunRecord(
            run_id=run_id,
            profile=profile_name,
            supervisor_pid=supervisor.pid,
            supervisor_start_ticks=supervisor.start_ticks,
            started_at=datetime.now(timezone.utc).isoformat(),
            python=sys.executable,
            output_directory=str(output_directory.absolute()),
            workspace=str(workspace.resolve()),
            is_robot=is_robot,
        )
        with contextlib.ExitStack() as undo:
            undo.callback(os.close, memory_lock_fd)
            undo.callback(remove_names, run_id, shared_memory)
            unfinished = base / f"{UNFINISHED_PREFIX}{run_id}"
            unfinished.mkdir(mode=0o700)
            lock_fd = lock_folder(unfinished)
            if lock_fd is None:
                raise BlockingIOError(f"{unfinished} was locked by another process as soon as it was made")
            undo.callback(os.close, lock_fd)
            write_private(unfinished / RECORD_NAME, json.dumps(asdict(record), indent=2) + "\n")
            unfinished.rename(base / run_id)
            (shared_memory / names.home(run_id)).symlink_to((base / run_id).absolute())
            undo.pop_all()
        return cls(base / run_id, record, shared_memory, [lock_fd, memory_lock_fd])

    def remove(self, disk: DiskWriter | None = None) -> None:
        """Remove the folder and the rest of the run's shared memory, then unlock both.

        Args:
            disk: removes the folder; if the disk has stalled, the next sweep removes the rest. None: this
                process removes it.
        """
        remove_names(self.run_id, self._shared_memory)
        if disk:
            disk.order(["remove", str(self.folder)], b"")
            disk.flush()
        else:
            shutil.rmtree(self.folder, ignore_errors=True)
        for lock_fd in self._lock_fds:
            os.close(lock_fd)


def base_folders() -> list[Path]:
    """Return the folders that may hold runs of this user; new ones go to the first."""
    folders = [Path(f"/tmp/robbie-{os.geteuid()}")]
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and _is_own(runtime):
        folders.insert(0, Path(runtime) / "robbie")
    # Cron and system services must see what a login session has started, too.
    login = LOGIN_SESSIONS / str(os.geteuid())
    if login / "robbie" not in folders and _is_own(login):
        folders.append(login / "robbie")
    return folders


def _is_own(folder: str | Path) -> bool:
    """Whether nobody else can replace what is in a folder. Under sudo it may be the other user's."""
    return os.path.exists(folder) and not ownership_problem(os.stat(folder), folder=True, readable=True)


def folders_of(run_id: str, bases: list[Path], shared_memory: Path = SHARED_MEMORY) -> list[Path]:
    """Return the folders of a run that exist: those in `bases`, and the one that its shared memory names.

    The latter is elsewhere if the run was started with another XDG_RUNTIME_DIR, as in a login session, from
    cron or by a system service.
    """
    folders = [base / run_id for base in bases]
    with (
        contextlib.suppress(SegmentMissing, SegmentMismatch, OSError),
        opened_folder(names.folder(run_id), shared_memory),  # so nobody else has made the link
    ):
        home = (shared_memory / names.home(run_id)).readlink()
        if home.name == run_id and home not in folders and not privacy_problem(home.parent):
            folders.append(home)
    return [folder for folder in folders if os.path.lexists(folder)]


def safe_folders() -> list[Path]:
    """Return those of `base_folders` that exist and that other users cannot have changed."""
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
    """Whether the supervisor of a run is alive."""
    lock_fd = lock_folder(folder, shared=True)
    if lock_fd is not None:
        os.close(lock_fd)
    return lock_fd is None and folder.exists()


def lock_folder(folder: Path, *, shared: bool = False) -> int | None:
    """Lock a folder; return the descriptor that holds the lock, None if it is locked or does not exist.

    Children do not inherit the descriptor (O_CLOEXEC), so none of them keeps a dead supervisor's lock.
    """
    try:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(fd), os.lstat(folder)):
            return fd
    except (BlockingIOError, FileNotFoundError):
        pass  # somebody else has locked it, or removed it before we could
    os.close(fd)
    return None


def read_record(folder: Path) -> RunRecord | None:
    """Return the record in a run's folder; None if it is missing, damaged, or of another version."""
    try:
        return msgspec.json.decode((folder / RECORD_NAME).read_bytes(), type=RunRecord)
    except (OSError, ValueError):
        return None


def _run_folders(bases: list[Path]) -> Iterator[Path]:
    for base in bases:
        with contextlib.suppress(FileNotFoundError):
            yield from sorted(path for path in base.iterdir() if RUN_ID.fullmatch(path.name))


def _reserve_run_id(base: Path, shared_memory: Path) -> tuple[str, int]:
    """Find an unused run id; make and lock the folder of its shared memory, and return the lock with it."""
    for _ in range(MAX_TRIES):
        run_id = secrets.token_hex(4)
        if not (base / run_id).exists():
            with contextlib.suppress(FileExistsError):
                if (lock_fd := lock_folder(make_folder(run_id, shared_memory))) is not None:
                    return run_id, lock_fd
    raise NamesTaken(f"all {MAX_TRIES} run ids that were tried are in use, such as {run_id}")


def privacy_problem(base: Path) -> str:
    """Return why a folder is not safe for runs, '' if it is safe.

    Raises:
        FileNotFoundError: the folder does not exist.
    """
    return ownership_problem(os.lstat(base), folder=True)


def make_private(base: Path) -> None:
    """Make a folder for runs, if there is none.

    Raises:
        UnsafeRunFolder: other users could change it.
    """
    with contextlib.suppress(FileExistsError):
        base.mkdir(mode=0o700)
    if problem := privacy_problem(base):
        raise UnsafeRunFolder(f"the folder for runs {base} {problem}; remove it or set XDG_RUNTIME_DIR")
