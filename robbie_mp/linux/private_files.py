"""Files and folders that only this user can read: a robot may write more than others should know."""

import os
from pathlib import Path
from typing import BinaryIO

PRIVATE_FOLDER = 0o700
PRIVATE_FILE = 0o600


def make_private_folder(folder: Path) -> None:
    """Make a folder, and those around it, without access for others; folders that exist stay as they are.

    Raises:
        OSError: it cannot be made, or is no folder.
    """
    if not folder.is_dir():
        make_private_folder(folder.parent)
        folder.mkdir(mode=PRIVATE_FOLDER, exist_ok=True)


def private_opener(path: str, flags: int) -> int:
    """Open a file so that others cannot read it if it is made by this; for `open(…, opener=…)`."""
    return os.open(path, flags | os.O_CLOEXEC, PRIVATE_FILE)


def make_private_file(path: Path) -> BinaryIO:
    """Make a file that others cannot read, for writing and reading.

    Raises:
        OSError: there is one already, or it cannot be made.
    """
    return os.fdopen(private_opener(str(path), os.O_RDWR | os.O_CREAT | os.O_EXCL), "w+b")


def write_private(path: Path, text: str) -> None:
    """Write a text file that others cannot read.

    Raises:
        OSError: there is no room, or the folder does not let us.
    """
    with open(path, "w", opener=private_opener) as file:
        file.write(text)
