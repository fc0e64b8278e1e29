"""Message types that a run has learnt since it began.

The plan has the types that the robot's modules declare when they are imported. A bridge that takes messages
of other types writes each type to a file in the run's folder before it publishes the first message, so that
recorders can read it. A module does so with a type, or a version, that the robot's code has got since.
"""

import errno
import json
import os
from pathlib import Path

from robbie_mp.base.linux.private_files import make_private_folder, write_private

TYPES_FOLDER = "types"
MAX_TYPES = 256
"""Most types that a run learns."""

Entry = tuple[str, int, str, str]
"""The content of a `TypeDescription`."""


def learn_type(run_directory: Path, entry: Entry) -> bool:
    """Write down a type, unless the run has learnt one of its name and version.

    Args:
        run_directory: the run's folder.
        entry: name, version, schema and Python module of the type.

    Returns:
        Whether the run now has this type; False: it has another one of this name and version.

    Raises:
        OSError: the file cannot be written, or the run has learnt too many types.
    """
    folder = run_directory / TYPES_FOLDER
    make_private_folder(folder)
    path = _file(run_directory, *entry[:2])
    if not path.exists() and len(list(folder.glob("*.json"))) >= MAX_TYPES:
        raise OSError(errno.ENOSPC, f"a run learns at most {MAX_TYPES} types")
    unfinished = path.with_suffix(f".{os.getpid()}")
    write_private(unfinished, json.dumps(entry))
    try:
        os.link(unfinished, path)  # whole, and only if there is none
    except FileExistsError:
        return _read(path)[:3] == entry[:3]  # a bridge names no Python module
    finally:
        unfinished.unlink()
    return True


def learnt_types(run_directory: Path) -> list[Entry]:
    """Return the types that a run has learnt so far, sorted by name and version."""
    return sorted(_read(path) for path in (run_directory / TYPES_FOLDER).glob("*.json"))


def learnt_schema(run_directory: Path, name: str, version: int) -> str | None:
    """Return the schema of a type that a run has learnt; None if it has not learnt this version."""
    try:
        return _read(_file(run_directory, name, version))[2]
    except FileNotFoundError:
        return None


def _file(run_directory: Path, name: str, version: int) -> Path:
    return run_directory / TYPES_FOLDER / f"{name.replace('/', '.')}.{version}.json"


def _read(path: Path) -> Entry:
    name, version, schema, module = json.loads(path.read_text())
    return name, version, schema, module
