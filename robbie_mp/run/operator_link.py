"""The links that open a run's operator page, and show it in Foxglove, with their tokens.

Only the run's user may see them.

They are files in the run's folder, which only this user may enter. None appears in a status, the trace or
a recording, which observers can read.
"""

import contextlib
import os
import secrets
from pathlib import Path

LINK_FILE = "operator-link"
TOKEN_FILE = "operator-token"
FOXGLOVE_LINK_FILE = "foxglove-link"
FOXGLOVE_TOKEN_FILE = "foxglove-token"
TOKEN_BYTES = 32
OWN = 0o600


def token_of_run(folder: Path, name: str = TOKEN_FILE) -> str:
    """Return the token of a run whose profile sets none; a restarted module gets the same one.

    Args:
        folder: the run's folder.
        name: the token's file.
    """
    file = folder / name
    with contextlib.suppress(FileNotFoundError):
        return file.read_text()
    token = secrets.token_urlsafe(TOKEN_BYTES)
    _write(file, token)
    return token


def write_link(folder: Path, link: str, name: str = LINK_FILE) -> None:
    """Write the link to the file that commands read."""
    _write(folder / name, link)


def read_link(folder: Path, name: str = LINK_FILE) -> str:
    """Return the link; '' if the run has no module that serves it, or the module is still starting."""
    with contextlib.suppress(FileNotFoundError):
        return (folder / name).read_text()
    return ""


def remove_link(folder: Path, name: str = LINK_FILE) -> None:
    """Remove the link: its page is no longer served."""
    (folder / name).unlink(missing_ok=True)


def _write(file: Path, text: str) -> None:
    """Write a file atomically; it is private from the moment it is created."""
    new = file.with_name(f"{file.name}.{os.getpid()}")
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, OWN)
    with open(descriptor, "w") as opened:
        opened.write(text)
    new.replace(file)
