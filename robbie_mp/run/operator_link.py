"""The links that open a run's operator page, and show it in Foxglove, with their tokens.

Only the run's user may see them.

They are files in the run's folder, which only this user may enter. None appears in a status, the trace or
a recording, which observers can read.
"""

import contextlib
import secrets
from pathlib import Path

from robbie_mp.base.linux.private_files import write_private

LINK_FILE = "operator-link"
TOKEN_FILE = "operator-token"
FOXGLOVE_LINK_FILE = "foxglove-link"
FOXGLOVE_TOKEN_FILE = "foxglove-token"
TOKEN_BYTES = 32


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
    write_private(file, token)
    return token


def write_link(folder: Path, link: str, name: str = LINK_FILE) -> None:
    """Write the link to the file that commands read."""
    write_private(folder / name, link)


def read_link(folder: Path, name: str = LINK_FILE) -> str:
    """Return the link; '' if the run has no module that serves it, or the module is still starting."""
    with contextlib.suppress(FileNotFoundError):
        return (folder / name).read_text()
    return ""


def remove_link(folder: Path, name: str = LINK_FILE) -> None:
    """Remove the link: its page is no longer served."""
    (folder / name).unlink(missing_ok=True)
