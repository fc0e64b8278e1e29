"""Files and folders that only this user can access: how to make them, and how to check one that exists.

A robot may write more than other users should read. And what another user could have written is not trusted.
No link in the place of a file is followed, nor one in the place of its folder. Where a user chooses a folder,
resolve its path first.
"""

import contextlib
import errno
import fcntl
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

PRIVATE_FOLDER = 0o700
PRIVATE_FILE = 0o600
UNFINISHED = ".new"
"""How the names of files end that are still being written; before it stands the writer's pid."""
_UNFINISHED_NAME = re.compile(rf"\..+\.[0-9]+{re.escape(UNFINISHED)}")
_swept: set[tuple[int, int, int]] = set()
"""Pid, device and inode of folders in which a process has removed what killed writers left."""


def make_private_folder(folder: Path) -> None:
    """Make a folder and its missing parents without access for others; existing folders stay as they are.

    Raises:
        OSError: it cannot be made, or is not a folder, or is a link to one.
    """
    _make_missing(folder)
    with real_folder(folder):
        pass


@contextlib.contextmanager
def real_folder(folder: Path) -> Iterator[int]:
    """Open a folder, not a link to one, and yield its descriptor; links may be planted to write elsewhere.

    Raises:
        OSError: it does not exist, is not a folder, or is a link to one.
    """
    try:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except NotADirectoryError as error:
        if not folder.is_symlink():
            raise
        raise OSError(errno.ELOOP, f"links to folders are not followed: {folder}") from error
    try:
        yield fd
    finally:
        os.close(fd)


def private_opener(path: str, flags: int) -> int:
    """Open a file, not a link; if that creates it, others cannot read it. For `open(…, opener=…)`."""
    folder, name = os.path.split(path)
    with real_folder(Path(folder)) as folder_fd:
        return _open(name, flags, folder_fd)


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
    unfinished = f".{path.name}.{os.getpid()}{UNFINISHED}"
    with real_folder(path.parent) as folder_fd:
        _remove_unfinished(folder_fd)
        try:
            with _make_unfinished(unfinished, folder_fd) as file:
                yield file
            os.replace(unfinished, path.name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
        except BaseException:
            _unlink(unfinished, folder_fd)
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


def _make_missing(folder: Path) -> None:
    if not folder.is_dir():
        _make_missing(folder.parent)
        folder.mkdir(mode=PRIVATE_FOLDER, exist_ok=True)


def _open(name: str, flags: int, folder_fd: int) -> int:
    return os.open(name, flags | os.O_NOFOLLOW | os.O_CLOEXEC, PRIVATE_FILE, dir_fd=folder_fd)


def _unlink(name: str, folder_fd: int) -> None:
    with contextlib.suppress(FileNotFoundError):
        os.unlink(name, dir_fd=folder_fd)


def _make_unfinished(name: str, folder_fd: int) -> BinaryIO:
    """Make a file and lock it (flock) while it is open, so that it is not taken for a killed writer's."""
    while True:
        _unlink(name, folder_fd)  # left by a killed process of the same pid, or a planted link
        file = os.fdopen(_open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL, folder_fd), "w+b")
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        if os.fstat(file.fileno()).st_nlink:
            return file
        file.close()  # somebody has removed it before it was locked


def _remove_unfinished(folder_fd: int) -> None:
    """Remove what killed writers left in a folder, once in each process."""
    found = os.fstat(folder_fd)
    folder = os.getpid(), found.st_dev, found.st_ino
    if folder in _swept:
        return
    _swept.add(folder)
    for name in filter(_UNFINISHED_NAME.fullmatch, os.listdir(folder_fd)):
        with contextlib.suppress(OSError):  # it is being written, or is not ours
            _remove_unlocked(name, folder_fd)


def _remove_unlocked(name: str, folder_fd: int) -> None:
    fd = _open(name, os.O_RDONLY | os.O_NONBLOCK, folder_fd)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.unlink(name, dir_fd=folder_fd)
    finally:
        os.close(fd)


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
