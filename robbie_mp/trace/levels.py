"""Which kinds of entries are recorded of whom: a file in the run's folder; children read it at SIGURG, too.

A log record of a kind that nobody records would cost its module time for nothing. SIGURG does nothing to who
does not expect it, so it may be sent to any child at any time.
"""

import json
import logging
import os
import signal
from collections.abc import Collection, Mapping
from pathlib import Path

from robbie_mp.linux.private_files import write_private
from robbie_mp.trace.kinds import Kind, lowest_level

RECORDED_FILE = "recorded_kinds.json"


def write_recorded(run_folder: Path, recorded: Mapping[str, Collection[Kind]]) -> None:
    """Say which kinds are recorded of each child, and of the supervisor's remarks."""
    unfinished = run_folder / f"{RECORDED_FILE}.new"
    write_private(unfinished, recorded_as_json(recorded).decode())
    os.replace(unfinished, run_folder / RECORDED_FILE)


def recorded_as_json(recorded: Mapping[str, Collection[Kind]]) -> bytes:
    """Return the content of the file."""
    plain = {name: [kind for kind in Kind if kind in kinds] for name, kinds in recorded.items()}
    return json.dumps(plain).encode()


def read_recorded(run_folder: Path) -> dict[str, list[Kind]]:
    """Return which kinds are recorded of whom; {} if nobody has said."""
    try:
        told = json.loads((run_folder / RECORDED_FILE).read_text())
        return {name: [Kind(kind) for kind in kinds] for name, kinds in told.items()}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


def read_level(run_folder: Path, name: str) -> int:
    """Return the lowest level of log records that a child is to make."""
    kinds = read_recorded(run_folder).get(name)
    return logging.INFO if kinds is None else lowest_level(kinds)


def follow_level(run_folder: Path, name: str) -> None:
    """Log at the level that is said for this process, now and whenever that changes."""
    root = logging.getLogger()
    signal.signal(signal.SIGURG, lambda _signal, _frame: root.setLevel(read_level(run_folder, name)))
    root.setLevel(read_level(run_folder, name))
