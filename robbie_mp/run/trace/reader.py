"""Reads a run's trace from its files, during the run or long after it."""

import contextlib
import heapq
import os
from collections.abc import Collection, Iterator
from pathlib import Path

from robbie_mp.run.trace.crash import CrashReport, report_files
from robbie_mp.run.trace.entry import Entry

LOG_FOLDER = "log"
"""Below a run's output directory (`RunRecord.output_directory`)."""
SUFFIX = ".jsonl"
EXPECTED_BYTES = 256


def module_names(output_directory: Path) -> list[str]:
    """Return the processes that have entries, in alphabetical order."""
    return sorted({path.name.split(".")[0] for path in trace_folder(output_directory).glob(f"*{SUFFIX}")})


def last_entries(output_directory: Path, module: str, count: int) -> list[Entry]:
    """Return the newest entries of a module, of "core" or of "supervisor"; empty if there are none."""
    found: list[Entry] = []
    for path in reversed(files_of(trace_folder(output_directory), module)):
        found = _last_of_file(path, count - len(found)) + found
        if len(found) >= count:
            break
    return found


def entries(output_directory: Path, modules: list[str] | None = None) -> Iterator[Entry]:
    """Yield the entries of a run in the order in which the supervisor received them.

    Args:
        output_directory: where the run writes its results.
        modules: only entries of these; None: of all.
    """
    folder = trace_folder(output_directory)
    names = module_names(output_directory) if modules is None else modules
    yield from heapq.merge(*(_entries_of(folder, name) for name in names), key=lambda entry: entry.number)


def crash_reports(
    output_directory: Path, module: str | None = None, newest: int | None = None
) -> list[CrashReport]:
    """Return the crash reports of a run, oldest first.

    Args:
        output_directory: where the run writes its results.
        module: only reports of this process; None: of all.
        newest: only this number of newest reports; None: all that are kept.
    """
    reports = []
    files = report_files(trace_folder(output_directory), module)
    for path in files if newest is None else files[max(0, len(files) - newest) :]:
        with contextlib.suppress(FileNotFoundError):  # it was removed as too old
            if report := CrashReport.from_json(path.read_text()):
                reports.append(report)
    return reports


def _last_of_file(path: Path, count: int) -> list[Entry]:
    """Read from the end, in growing pieces, until there are enough entries."""
    read_bytes = count * EXPECTED_BYTES
    while True:
        try:
            with path.open("rb") as file:
                size = file.seek(0, os.SEEK_END)
                file.seek(max(0, size - read_bytes))
                lines = file.read().splitlines()
        except FileNotFoundError:
            return []
        found = [entry for line in lines if (entry := Entry.from_line(line))]
        if len(found) >= count or read_bytes >= size:
            return found[max(0, len(found) - count) :]
        read_bytes *= 4


def _entries_of(folder: Path, module: str) -> Iterator[Entry]:
    for path in files_of(folder, module):
        try:
            with path.open("rb") as file:
                for line in file:
                    if entry := Entry.from_line(line):
                        yield entry
        except FileNotFoundError:
            continue  # rotated away in the meantime


def files_of(folder: Path, module: str) -> list[Path]:
    """Return the files of a module, oldest first; the last one need not exist."""
    numbered = {}
    for path in folder.glob(f"{module}.*{SUFFIX}"):
        number = path.name.removeprefix(f"{module}.").removesuffix(SUFFIX)
        if number.isdigit():
            numbered[int(number)] = path
    return [*(numbered[number] for number in sorted(numbered, reverse=True)), folder / f"{module}{SUFFIX}"]


def trace_folder(output_directory: Path) -> Path:
    """Return the folder of a run's trace."""
    return output_directory / LOG_FOLDER


class TraceFollower:
    """Reads the new entries of a run's trace with each call, while its files rotate."""

    def __init__(self, output_directory: Path, modules: Collection[str] | None = None):
        """Prepare to read from the beginning.

        Args:
            output_directory: where the run writes its results.
            modules: only entries of these; None: of all.
        """
        self._output_directory = output_directory
        self._modules = modules
        self._read: dict[str, tuple[int, int]] = {}
        """By module: the inode of the newest file read, and the offset read up to."""

    def read_new(self) -> list[Entry]:
        """Return the entries since the last call, in the order in which the supervisor received them."""
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
                        break  # rotated since it was listed; it is read next time
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
