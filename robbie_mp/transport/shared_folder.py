"""The folder in /dev/shm that holds a run's segments, and all that a run has there.

Every user can make names in /dev/shm and sees those of all others. A user who knows a name before it is used
can take it, so that a process does not start, or put forged memory there. In a folder of mode 0700 no other
user can do either. They cannot remove the folder, because /dev/shm has the sticky bit. Besides, nothing is
opened without a check of its owner and mode.
"""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from robbie_mp.errors import RobbieError
from robbie_mp.linux.private_files import ownership_problem
from robbie_mp.transport import names

SHARED_MEMORY = Path("/dev/shm")


class SegmentMissing(RobbieError, FileNotFoundError):
    """No segment has that name: its run is over, or never was."""


class NamesTaken(RobbieError, FileExistsError):
    """Every name in shared memory that was tried exists already.

    Example scenarios:
      - another user fills /dev/shm with such names; `ls -l /dev/shm` shows who
    """


class SegmentMismatch(RobbieError, ValueError):
    """A segment is not what its name promises, or comes from another version of Robbie-MP."""


class ForeignMemory(SegmentMismatch):
    """Shared memory is not ours alone, so that what is in it may be forged; it is not touched.

    Example scenarios:
      - another user has made a folder with the name of a run
      - somebody has changed the mode of a segment
    """


def make_folder(run_id: str) -> None:
    """Make the folder of a new run.

    Raises:
        FileExistsError: the name is taken, by whomever; take another run id.
    """
    (SHARED_MEMORY / names.folder(run_id)).mkdir(mode=0o700)


@contextlib.contextmanager
def opened_folder(name: str, shared_memory: Path = SHARED_MEMORY) -> Iterator[int]:
    """Open the folder of a run and give its descriptor, by which nothing foreign can be reached.

    Raises:
        SegmentMissing: there is none.
        ForeignMemory: it is not ours alone, or no folder.
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
    """Remove all that a run of ours has in shared memory, and return the names; others' names stay."""
    removed = []
    with (
        contextlib.suppress(SegmentMissing, ForeignMemory),
        opened_folder(names.folder(run_id), shared_memory) as fd,
    ):
        for file in sorted(os.listdir(fd)):
            with contextlib.suppress(OSError):
                os.unlink(file, dir_fd=fd)
                removed.append(f"{names.folder(run_id)}/{file}")
        with contextlib.suppress(OSError):
            os.rmdir(shared_memory / names.folder(run_id))
            removed.append(names.folder(run_id))
    for path in sorted(shared_memory.glob(f"sem.{names.folder(run_id)}.*")):
        with contextlib.suppress(OSError):
            if is_own(path.lstat()):
                path.unlink()
                removed.append(path.name)
    return removed


def is_own(found: os.stat_result) -> bool:
    """Whether a name in /dev/shm belongs to us. Nobody else can replace it then: /dev/shm is sticky."""
    return found.st_uid == os.geteuid() and (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode))
