"""Files and folders that only this user can access: how to make them, and how to check one that exists.

A robot may write more than other users should read. And what another user could have written is not trusted.
"""

import os
import stat
from pathlib import Path
from typing import BinaryIO

PRIVATE_FOLDER = 0o700
PRIVATE_FILE = 0o600


def make_private_folder(folder: Path) -> None:
    """Make a folder and its missing parents without access for others; existing folders stay as they are.

    Raises:
        OSError: it cannot be made, or is not a folder.
    """
    if not folder.is_dir():
        make_private_folder(folder.parent)
        folder.mkdir(mode=PRIVATE_FOLDER, exist_ok=True)


def private_opener(path: str, flags: int) -> int:
    """Open a file; if that creates it, others cannot read it. For `open(…, opener=…)`."""
    return os.open(path, flags | os.O_CLOEXEC, PRIVATE_FILE)


def make_private_file(path: Path) -> BinaryIO:
    """Make a file that others cannot read, and open it for writing and reading.

    Raises:
        OSError: the file exists already, or cannot be made.
    """
    return os.fdopen(private_opener(str(path), os.O_RDWR | os.O_CREAT | os.O_EXCL), "w+b")


def write_private(path: Path, text: str) -> None:
    """Write a text file that others cannot read.

    Raises:
        OSError: there is no space, or no permission to write into the folder.
    """
    with open(path, "w", opener=private_opener) as file:
        file.write(text)


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
