"""The files of a robot that this interpreter has imported."""

import contextlib
import json
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from robbie_mp.base.linux.private_files import make_private_folder, write_private
from robbie_mp.base.stock_robots import ROBOTS

FOLDER = "imported"
"""The folder in a run's folder with a file for each module, if the run reloads what is saved."""
MAX_BYTES = 1 << 22
Version = tuple[int, int]
"""Modification time in ns and size of a file."""


def imported_files(*folders: str) -> list[str]:
    """Return the files below these folders that this interpreter has imported."""
    below = tuple(os.path.join(folder, "") for folder in folders)
    files = [getattr(module, "__file__", None) or "" for module in list(sys.modules.values())]
    return [file for file in files if file.startswith(below)]


def robot_files(workspace: str) -> list[str]:
    """Return the files of a workspace, and of the stock robots, that this interpreter has imported."""
    return imported_files(workspace, str(ROBOTS))


def version_of(file: str) -> Version | None:
    """Return the version of a file; None: there is no such file."""
    try:
        stat = os.stat(file)
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size


def versions(files: Iterable[str]) -> dict[str, Version | None]:
    """Return the version of each file."""
    return {file: version_of(file) for file in files}


def report_imports(run_folder: Path, name: str, workspace: str) -> None:
    """In a module's process: write which files it has imported, for the supervisor."""
    make_private_folder(run_folder / FOLDER)
    write_private(run_folder / FOLDER / name, json.dumps(versions(robot_files(workspace))))


def read_imports(path: Path) -> dict[str, Version | None]:
    """Read what a module's process has reported; nothing if that is not there, or has another form."""
    with contextlib.suppress(OSError, ValueError, RecursionError), path.open("rb") as file:
        return checked_versions(json.loads(file.read(MAX_BYTES)))
    return {}


def checked_versions(told: Any) -> dict[str, Version | None]:
    """Return the file versions that another process reported, without those that are malformed."""
    found: dict[str, Version | None] = {}
    for file, version in told.items() if isinstance(told, dict) else ():
        match version:
            case [int(mtime_ns), int(size)]:
                found[file] = (mtime_ns, size)
            case None:
                found[file] = None
    return found
