"""The link that opens a run's operator page, and the token in it. Only the run's user may see them.

Both are files in the run's folder, which only this user may enter. Neither appears in a status, the trace or
a recording, which observers can read.
"""

import contextlib
import os
import secrets
from pathlib import Path

LINK_FILE = "operator-link"
TOKEN_FILE = "operator-token"
TOKEN_BYTES = 32
OWN = 0o600


def token_of_run(folder: Path) -> str:
    """Return the token of a run whose profile sets none; a restarted station gets the same one.

    Args:
        folder: the run's folder.
    """
    file = folder / TOKEN_FILE
    with contextlib.suppress(FileNotFoundError):
        return file.read_text()
    token = secrets.token_urlsafe(TOKEN_BYTES)
    _write(file, token)
    return token


def write_link(folder: Path, link: str) -> None:
    """Write the link to the file that commands read."""
    _write(folder / LINK_FILE, link)


def read_link(folder: Path) -> str:
    """Return the link; '' if the run has no operator station or the station is still starting."""
    with contextlib.suppress(FileNotFoundError):
        return (folder / LINK_FILE).read_text()
    return ""


def remove_link(folder: Path) -> None:
    """Remove the link: its page is no longer served."""
    (folder / LINK_FILE).unlink(missing_ok=True)


def _write(file: Path, text: str) -> None:
    """Write a file atomically; it is private from the moment it is created."""
    new = file.with_name(f"{file.name}.{os.getpid()}")
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, OWN)
    with open(descriptor, "w") as opened:
        opened.write(text)
    new.replace(file)
