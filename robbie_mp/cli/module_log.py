"""The end of what a module has said, and its last crash, out of the trace."""

import time
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.trace.entry import Entry
from robbie_mp.trace.reader import last_entries

READ_ENTRIES = 500
CRASH_BEGINS = ("Traceback (most recent call last):", "Fatal Python error:")
"""Of what is printed: by threads and children of a module, and by faulthandler."""
CRASH_LINES = 60


@dataclass(frozen=True)
class ModuleLog:
    """The end of a module's log."""

    lines: tuple[str, ...]
    """The last ones, each entry with its time."""
    crash: tuple[str, ...]
    """Which start crashed and when, then the traceback or stack dump; empty if none was found."""


def read_module_log(output_directory: Path, module: str, line_count: int) -> ModuleLog:
    """Read the end of a module's log; nothing that is missing is an error.

    Args:
        output_directory: of the run.
        module: its name; also "core".
        line_count: how many of the last lines.
    """
    entries = last_entries(output_directory, module, READ_ENTRIES)
    lines = [f"{_clock(entry)} {line}" for entry in entries[-line_count:] for line in entry.lines()]
    return ModuleLog(tuple(lines[-line_count:]), _last_crash(entries))


def _last_crash(entries: list[Entry]) -> tuple[str, ...]:
    for number in range(len(entries) - 1, -1, -1):
        entry = entries[number]
        if entry.level == "CRITICAL" and entry.traceback:
            lines = entry.lines()
        elif entry.stream == "stderr" and entry.text.startswith(CRASH_BEGINS):
            same = (entry.stream, entry.incarnation)
            lines = [one.text for one in entries[number:] if (one.stream, one.incarnation) == same]
        else:
            continue
        return (f"start {entry.incarnation}, {_clock(entry)}", *lines[:CRASH_LINES])
    return ()


def _clock(entry: Entry) -> str:
    return time.strftime("%H:%M:%S", time.localtime(entry.time_s))
