"""Files and folders that only this user can access: how to make them, and how to check one that exists.

A robot may write more than other users should read. And what another user could have written is not trusted.
"""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

PRIVATE_FOLDER = 0o700
PRIVATE_FILE = 0o600
UNFINISHED = ".new"
"""How the names of files end that are still being written; before it stands the writer's pid."""


def make_private_folder(folder: Path) -> None:
    """Make a folder and its missing parents without access for others; existing folders stay as they are.

    Raises:
        OSError: it cannot be made, or is not a folder.
    """
    if not folder.is_dir():
        make_private_folder(folder.parent)
        folder.mkdir(mode=PRIVATE_FOLDER, exist_ok=True)


def private_opener(path: str, flags: int) -> int:
    """Open a file, not a link; if that creates it, others cannot read it. For `open(…, opener=…)`."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, PRIVATE_FILE)


def make_private_file(path: Path) -> BinaryIO:
    """Make a file that others cannot read, and open it for writing and reading.

    Raises:
        OSError: the file exists already, or cannot be made.
    """
    return os.fdopen(private_opener(str(path), os.O_RDWR | os.O_CREAT | os.O_EXCL), "w+b")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Yield a new file that others cannot read; at the end it takes the place of what is at `path`.

    So a link there is not followed, an earlier file's mode does not stay, and no reader sees half a file.

    Raises:
        OSError: there is no space, no permission to write into the folder, or `path` is a folder.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}{UNFINISHED}")
    unfinished.unlink(missing_ok=True)  # left by a killed process of the same pid, or a planted link
    try:
        with make_private_file(unfinished) as file:
            yield file
        unfinished.replace(path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def write_private(path: Path, content: str | bytes | memoryview, *, durably: bool = False) -> None:
    """Write a file as `replacing` does.

    Args:
        path: the file.
        content: what it will hold.
        durably: return when the content is on the disk.

    Raises:
        OSError: as for `replacing`.
    """
    with replacing(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)
        if durably:
            file.flush()
            os.fsync(file.fileno())


def ownership_problem(found: os.stat_result, *, folder: bool = False, readable: bool = False) -> str:
    """Return why a file or folder is not safe to use because of its owner or mode, '' if it is safe.

    Args:
        found: the result of fstat(2), or of lstat(2) if nobody else can replace the file.
        folder: whether a folder is expected; otherwise a regular file.
        readable: whether others may read it. They may never write to it.
    """
    if not (stat.S_ISDIR if folder else stat.S_ISREG)(found.st_mode):
        return "is no directory" if folder else "is no regular file"
    if found.st_uid != os.geteuid():
        return f"belongs to user {found.st_uid}, not to us ({os.geteuid()})"
    if readable and found.st_mode & 0o022:
        return f"has mode {stat.S_IMODE(found.st_mode):04o}, others must not be able to write to it"
    if not readable and found.st_mode & 0o077:
        private = "0700" if folder else "0600"
        return f"has mode {stat.S_IMODE(found.st_mode):04o}, others must have no access ({private})"
    return ""
