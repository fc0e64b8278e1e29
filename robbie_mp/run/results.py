"""The folders with results of earlier runs, `output/PROFILE/TIME-PID`, and how long they are kept."""

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.run.run_directory import list_runs

NAME = re.compile(r"\d{8}T\d{6}Z-\d+")
"""A folder that has another name, such as one that the user has renamed, is never removed."""
RECORDING = ".mcap"


@dataclass(frozen=True)
class RunResults:
    """Results of a run that has ended."""

    folder: Path
    changed_s: float
    """When anything in it was changed last, seconds since 1970."""
    bytes: int
    has_recording: bool

    def remove(self) -> None:
        """Remove the folder; what cannot be removed stays."""
        shutil.rmtree(self.folder, ignore_errors=True)


def results_below(folder: Path) -> list[RunResults]:
    """Return the results below a folder, those that were changed longest ago first; none of live runs."""
    live = {run.record.output_directory for run in list_runs() if run.is_live and run.record}
    found = [_read(path) for path in _result_folders(folder) if str(path.resolve()) not in live]
    return sorted(found, key=lambda one: one.changed_s)


def remove_oldest(folder: Path, kept: int) -> list[RunResults]:
    """Remove the oldest results in the folder of a profile, and return them.

    Recordings cannot be made again, so results with recordings are neither counted nor removed.

    Args:
        folder: such as `output/demo`.
        kept: how many stay; 0: all.
    """
    found = [one for one in results_below(folder) if not one.has_recording]
    oldest = found[:-kept] if kept else []
    for one in oldest:
        one.remove()
    return oldest


def _result_folders(folder: Path) -> Iterator[Path]:
    """Find folders by their names, without those in them."""
    for root, folders, _ in os.walk(folder):
        results = [name for name in folders if NAME.fullmatch(name)]
        yield from (Path(root, name) for name in results if not Path(root, name).is_symlink())
        folders[:] = [name for name in folders if name not in results]


def _read(folder: Path) -> RunResults:
    changed_s, size, has_recording = 0.0, 0, False
    with contextlib.suppress(FileNotFoundError):  # another run that starts has just removed it
        changed_s = folder.lstat().st_mtime
    for root, _, files in os.walk(folder):
        for name in files:
            with contextlib.suppress(FileNotFoundError):
                found = os.lstat(os.path.join(root, name))
                changed_s, size = max(changed_s, found.st_mtime), size + found.st_size
                has_recording |= name.endswith(RECORDING)
    return RunResults(folder, changed_s, size, has_recording)
