"""Reads what is new in a run's trace, again and again, while its files rotate."""

import os
from collections.abc import Collection
from pathlib import Path

from robbie_mp.trace.entry import Entry
from robbie_mp.trace.reader import files_of, module_names, trace_folder


class TraceFollower:
    """Knows how far it has read each module's files."""

    def __init__(self, output_directory: Path, modules: Collection[str] | None = None):
        """Prepare to read from the beginning.

        Args:
            output_directory: where the run writes its results.
            modules: whose entries; None: everybody's.
        """
        self._output_directory = output_directory
        self._modules = modules
        self._read: dict[str, tuple[int, int]] = {}
        """By module: inode of the newest file that was read, and how far."""

    def read_new(self) -> list[Entry]:
        """Return what came since the last call, in the order in which the supervisor heard it."""
        names = module_names(self._output_directory) if self._modules is None else self._modules
        found = [entry for name in names for entry in self._new_of(name)]
        return sorted(found, key=lambda entry: entry.number)

    def _new_of(self, module: str) -> list[Entry]:
        found: list[Entry] = []
        known, offset = self._read.get(module, (0, 0))
        files = [(path, inode) for path in self._files(module) if (inode := _inode(path))]
        begin = next((at for at, (_, inode) in enumerate(files) if inode == known), None)
        if begin is None:
            begin, offset = 0, 0
        for path, inode in files[begin:]:
            try:
                with path.open("rb") as file:
                    if os.fstat(file.fileno()).st_ino != inode:
                        break  # rotated since we looked; next time
                    file.seek(offset)
                    data = file.read()
            except FileNotFoundError:
                break
            whole = data[: data.rfind(b"\n") + 1]
            found += [entry for line in whole.splitlines() if (entry := Entry.from_line(line))]
            self._read[module] = (inode, offset + len(whole))
            offset = 0
        return found

    def _files(self, module: str) -> list[Path]:
        return files_of(trace_folder(self._output_directory), module)


def _inode(path: Path) -> int:
    try:
        return path.stat().st_ino
    except FileNotFoundError:
        return 0
