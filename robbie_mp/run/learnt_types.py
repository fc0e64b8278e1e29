"""Message types that a run has learnt from another system since it began.

The plan has the types that the robot's modules declare. A bridge that takes messages of other types writes
each type to a file in the run's folder before it publishes the first message, so that recorders can read
it.
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
    """Write down a type, unless the run has learnt one of its name.

    Args:
        run_directory: the run's folder.
        entry: name, version, schema and Python module of the type.

    Returns:
        Whether the run now has this type; False: it has another one of this name.

    Raises:
        OSError: the file cannot be written, or the run has learnt too many types.
    """
    folder = run_directory / TYPES_FOLDER
    make_private_folder(folder)
    path = folder / f"{entry[0].replace('/', '.')}.json"
    if not path.exists() and len(list(folder.glob("*.json"))) >= MAX_TYPES:
        raise OSError(errno.ENOSPC, f"a run learns at most {MAX_TYPES} types")
    unfinished = path.with_suffix(f".{os.getpid()}")
    write_private(unfinished, json.dumps(entry))
    try:
        os.link(unfinished, path)  # whole, and only if there is none
    except FileExistsError:
        return _read(path) == entry
    finally:
        unfinished.unlink()
    return True


def learnt_types(run_directory: Path) -> list[Entry]:
    """Return the types that a run has learnt so far, sorted by file name."""
    return [_read(path) for path in sorted((run_directory / TYPES_FOLDER).glob("*.json"))]


def _read(path: Path) -> Entry:
    name, version, schema, module = json.loads(path.read_text())
    return name, version, schema, module
