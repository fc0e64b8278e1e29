"""The trace of the run that a log was recorded in: from its files, or else from the messages of the log."""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.logs.recording.reader import Log, open_log
from robbie_mp.messages import Log as LogLine
from robbie_mp.messages import Message, MessageError, ModuleState
from robbie_mp.run.trace.crash import CrashReport
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.reader import crash_reports, entries, module_names
from robbie_mp.station.page.log_events import CRASHED

MAX_ENTRIES = 20_000
"""The newest ones that are kept."""
MAX_READ = 500_000
"""Number of entries that are read of one log; it takes about a minute of a busy machine."""
FOLDERS_UP = 3
"""A log, or its folder, lies at most so deep in the results of its run."""
ENTRIES_PER_TURN = 100
"""Number of entries read before other threads get the processor."""


class LogTrace:
    """Reads the trace of a log once, in a separate thread.

    Attributes:
        entries: all of the log's time, by time. The tuple is replaced, never changed: pages read it.
        modules: those that have entries.
        reports: crash reports of the log's time.
        error: why there is none; '' if there is no error.
    """

    def __init__(self) -> None:
        self.entries: tuple[Entry, ...] = ()
        self.modules: list[str] = []
        self.reports: list[CrashReport] = []
        self.error = ""
        self._times: list[float] = []
        self._file = self._cut = ""

    def read(self, file: str) -> None:
        """Start to read the trace of a log, unless it is the last one read. Call this in one thread only."""
        if file != self._file:
            self._file = file
            threading.Thread(target=self._read, args=(file,), name="trace of a log", daemon=True).start()

    def until(self, time_s: float, at_most: int) -> tuple[Entry, ...]:
        """Return the newest entries up to a time of the log, the oldest first."""
        found, times = self.entries, self._times
        end = bisect_right(times, time_s)
        return found[max(0, end - at_most) : end]

    def _newest(self, file: str, found: Iterable[Entry]) -> list[Entry]:
        """Return the newest entries of those that are read, which end when another log is opened."""
        kept: deque[Entry] = deque(maxlen=MAX_ENTRIES)
        self._cut = ""
        for number, entry in enumerate(found):
            if number >= MAX_READ:
                self._cut = f"only the first {MAX_READ} entries of the log's trace are read"
                break
            if number % ENTRIES_PER_TURN == 0:
                if file != self._file:
                    break
                time.sleep(0.001)
            kept.append(entry)
        return list(kept)

    def _read(self, file: str) -> None:
        found: list[Entry] = []
        reports: list[CrashReport] = []
        error = ""
        try:
            with open_log(Path(file)) as log:
                begin_s, end_s = log.start_ns / 1e9, log.end_ns / 1e9
                folder = results_of(Path(file))
                if folder is not None:
                    inside = (one for one in entries(folder) if begin_s <= one.time_s <= end_s)
                    found = sorted(self._newest(file, inside), key=lambda entry: entry.time_s)
                    reports = [one for one in crash_reports(folder) if begin_s <= one.time_s <= end_s]
                if not found:
                    found = self._newest(file, entries_of_messages(log))
        except (RobbieError, OSError) as unreadable:
            error = str(unreadable)
        if file == self._file:
            error = error or self._cut
            found = [replace(entry, number=number) for number, entry in enumerate(found, 1)]
            self._times = [entry.time_s for entry in found]
            self.entries, self.reports, self.error = tuple(found), reports, error
            self.modules = sorted({entry.module for entry in found})


def results_of(path: Path) -> Path | None:
    """Return the folder with the results of the run in which a log lies; None if there is no trace."""
    folders = path.resolve().parents[:FOLDERS_UP]
    return next((folder for folder in folders if module_names(folder)), None)


def entries_of_messages(log: Log) -> Iterator[Entry]:
    """Yield what the messages of a log say: states of modules, and log lines of ROS."""
    kinds: dict[str, type[Message]] = {one.type_name: one for one in (ModuleState, LogLine)}
    channels = [
        one for one in log.channels if (kind := kinds.get(one.type_name)) and kind.version == one.version
    ]
    numbers = count(1)
    for message in log.messages(channels=channels):
        try:
            said = kinds[message.channel.type_name].decode(message.data)
        except MessageError:
            continue
        how, module, text = _said(said)
        yield Entry(next(numbers), message.time_ns / 1e9, how, module, 0, "log", text)


def _said(message: Message) -> tuple[Kind, str, str]:
    if isinstance(message, ModuleState):
        text = f"{message.state}{message.reason and f': {message.reason}'}"
        return Kind.ERROR if message.state in CRASHED else Kind.INFO, message.module, text
    assert isinstance(message, LogLine)
    grave = Kind.ERROR if message.level >= LogLine.ERROR else Kind.WARNING
    return grave if message.level >= LogLine.WARN else Kind.INFO, message.name, message.msg
