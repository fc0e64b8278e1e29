"""The end of a module's log and its last crash, from the trace."""

import time
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.trace.entry import Entry
from robbie_mp.trace.reader import crash_reports, last_entries

CRASH_LINES = 60


@dataclass(frozen=True)
class ModuleLog:
    """The end of a module's log."""

    lines: tuple[str, ...]
    """The last lines, each entry with its time."""
    crash: tuple[str, ...]
    """Which start crashed, when and why, then the report; empty if there was no crash."""


def read_module_log(output_directory: Path, module: str, line_count: int) -> ModuleLog:
    """Read the end of a module's log. Missing files are no error.

    Args:
        output_directory: of the run.
        module: its name, or "core".
        line_count: maximum number of lines.
    """
    entries = last_entries(output_directory, module, line_count)
    lines = [f"{_clock(entry.time_s)} {line}" for entry in entries for line in _lines(entry)]
    return ModuleLog(tuple(lines[-line_count:]), _last_crash(output_directory, module))


def _lines(entry: Entry) -> list[str]:
    return [entry.text] if entry.crash_report else entry.lines()


def _last_crash(output_directory: Path, module: str) -> tuple[str, ...]:
    for report in crash_reports(output_directory, module, newest=1):
        title = f"start {report.incarnation}, {_clock(report.time_s)}, {report.reason}"
        return (title, *report.lines()[1:CRASH_LINES])
    return ()


def _clock(time_s: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(time_s))
