"""The folder in /dev/shm that holds a run's segments.

Every user can create names in /dev/shm and see all others. A user who knows a name in advance can take it, so
that a process does not start, or can put forged memory there. No other user can do that in a folder of mode
0700, nor remove the folder, because /dev/shm has the sticky bit. In addition, every file is opened with a
check of its owner and mode.
"""

import contextlib
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import ownership_problem
from robbie_mp.bus.transport import names

SHARED_MEMORY = Path(os.environ.get("ROBBIE_SHARED_MEMORY", "/dev/shm"))
"""Another folder, which must have the sticky bit, too, keeps runs apart, such as those of tests."""


class SegmentMissing(RobbieError, FileNotFoundError):
    """No segment has that name: its run is over, or never was."""


class NamesTaken(RobbieError, FileExistsError):
    """Every name in shared memory that was tried exists already.

    Example scenarios:
      - another user fills /dev/shm with such names; `ls -l /dev/shm` shows the user
    """


class SegmentMismatch(RobbieError, ValueError):
    """A segment is not of the kind that its name says, or is from another version of Robbie-MP."""


class ForeignMemory(SegmentMismatch):
    """Other users have access to shared memory, so it may be forged; it is not used.

    Example scenarios:
      - another user has made a folder with the name of a run
      - the mode of a segment was changed
    """


def make_folder(run_id: str, shared_memory: Path = SHARED_MEMORY) -> Path:
    """Make the folder of a new run, and return it.

    Raises:
        FileExistsError: the name is taken; choose another run id.
    """
    folder = shared_memory / names.folder(run_id)
    folder.mkdir(mode=0o700)
    return folder


@contextlib.contextmanager
def opened_folder(name: str, shared_memory: Path = SHARED_MEMORY) -> Iterator[int]:
    """Open the folder of a run and yield its descriptor; other users cannot replace files below it.

    Raises:
        SegmentMissing: there is none.
        ForeignMemory: other users have access to it, or it is not a folder.
    """
    path = shared_memory / name
    try:
        fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError as error:
        raise SegmentMissing(f"there is no shared memory {path}; its run is over") from error
    except (NotADirectoryError, PermissionError) as error:
        raise ForeignMemory(f"{path} is not ours: {error.strerror}") from error
    try:
        if problem := ownership_problem(os.fstat(fd), folder=True):
            raise ForeignMemory(f"{path} {problem}")
        yield fd
    finally:
        os.close(fd)


def remove_names(run_id: str, shared_memory: Path = SHARED_MEMORY) -> list[str]:
    """Remove everything that this user's run has in shared memory, and return the names."""
    removed = []
    with (
        contextlib.suppress(SegmentMissing, ForeignMemory),
        opened_folder(names.folder(run_id), shared_memory) as fd,
    ):
        for file in sorted(os.listdir(fd)):
            with contextlib.suppress(OSError):
                remove_file(file, fd)
                removed.append(f"{names.folder(run_id)}/{file}")
        with contextlib.suppress(OSError):
            os.rmdir(shared_memory / names.folder(run_id))
            removed.append(names.folder(run_id))
    return removed


def remove_file(file: str, folder_fd: int) -> None:
    """Remove a file, or a folder that some module has made in its place."""
    try:
        os.unlink(file, dir_fd=folder_fd)
    except IsADirectoryError:
        shutil.rmtree(f"/proc/self/fd/{folder_fd}/{file}")  # its dir_fd is new in Python 3.11


def is_own(found: os.stat_result) -> bool:
    """Whether a file in /dev/shm is this user's; then the sticky bit keeps others from replacing it."""
    return found.st_uid == os.geteuid() and (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode))
