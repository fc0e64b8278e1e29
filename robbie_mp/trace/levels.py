"""Which log records a child makes at all: a file in the run's folder, read at the start and at SIGURG.

A record of a kind that nobody records would cost its module time for nothing. SIGURG does nothing to who does
not expect it, so it may be sent to any child at any time.
"""

import json
import logging
import os
import signal
from collections.abc import Mapping
from pathlib import Path

LEVELS_FILE = "log_levels.json"


def write_levels(run_folder: Path, levels: Mapping[str, int]) -> None:
    """Say the lowest level of records that each child is to make."""
    unfinished = run_folder / f"{LEVELS_FILE}.new"
    unfinished.write_text(json.dumps(levels))
    os.replace(unfinished, run_folder / LEVELS_FILE)


def read_level(run_folder: Path, name: str) -> int:
    """Return the lowest level of records that a child is to make."""
    try:
        return int(json.loads((run_folder / LEVELS_FILE).read_text())[name])
    except (OSError, ValueError, KeyError):
        return logging.INFO


def follow_level(run_folder: Path, name: str) -> None:
    """Log at the level that is said for this process, now and whenever that changes."""
    root = logging.getLogger()
    signal.signal(signal.SIGURG, lambda _signal, _frame: root.setLevel(read_level(run_folder, name)))
    root.setLevel(read_level(run_folder, name))
