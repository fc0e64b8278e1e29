"""Reads a run's trace from its files, while the run goes on or long after."""

import contextlib
import heapq
import os
from collections.abc import Iterator
from pathlib import Path

from robbie_mp.trace.crash import CrashReport, report_files
from robbie_mp.trace.entry import Entry

LOG_FOLDER = "log"
"""Below a run's output directory (`RunRecord.output_directory`)."""
SUFFIX = ".jsonl"
EXPECTED_BYTES = 256


def module_names(output_directory: Path) -> list[str]:
    """Return who has said anything, in alphabetical order."""
    return sorted({path.name.split(".")[0] for path in trace_folder(output_directory).glob(f"*{SUFFIX}")})


def last_entries(output_directory: Path, module: str, count: int) -> list[Entry]:
    """Return the newest entries of one module, or of "core" or "supervisor"; empty if there are none."""
    found: list[Entry] = []
    for path in reversed(files_of(trace_folder(output_directory), module)):
        found = _last_of_file(path, count - len(found)) + found
        if len(found) >= count:
            break
    return found


def entries(output_directory: Path, modules: list[str] | None = None) -> Iterator[Entry]:
    """Yield the entries of a run in the order in which the supervisor heard them.

    Args:
        output_directory: where the run writes its results.
        modules: whose; None: everybody's.
    """
    folder = trace_folder(output_directory)
    names = module_names(output_directory) if modules is None else modules
    yield from heapq.merge(*(_entries_of(folder, name) for name in names), key=lambda entry: entry.number)


def crash_reports(output_directory: Path, module: str | None = None, newest: int = 0) -> list[CrashReport]:
    """Return the reports of a run's crashes, the oldest first.

    Args:
        output_directory: where the run writes its results.
        module: whose; None: everybody's.
        newest: only so many, the newest; 0: all that are kept.
    """
    reports = []
    for path in report_files(trace_folder(output_directory), module)[-newest:]:
        with contextlib.suppress(FileNotFoundError):  # it was too old meanwhile
            if report := CrashReport.from_json(path.read_text()):
                reports.append(report)
    return reports


def _last_of_file(path: Path, count: int) -> list[Entry]:
    """Read from the end, more and more, until there are enough entries."""
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
            continue  # rotated away meanwhile


def files_of(folder: Path, module: str) -> list[Path]:
    """Return the files of a module, the oldest first; the last one need not exist."""
    numbered = {}
    for path in folder.glob(f"{module}.*{SUFFIX}"):
        number = path.name.removeprefix(f"{module}.").removesuffix(SUFFIX)
        if number.isdigit():
            numbered[int(number)] = path
    return [*(numbered[number] for number in sorted(numbered, reverse=True)), folder / f"{module}{SUFFIX}"]


def trace_folder(output_directory: Path) -> Path:
    """Return where a run's trace is."""
    return output_directory / LOG_FOLDER
