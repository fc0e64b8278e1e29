"""The output of children as entries of the trace: written to files, shown, and the last lines kept.

Nothing here waits for the disk; see `robbie_mp.run.trace.disk_writer`. Each child has separate files, so a
verbose child displaces only its own lines. Lines beyond the rate limit are dropped and counted.
"""

import json
import os
import time
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import make_private_folder
from robbie_mp.base.token_bucket import TokenBucket
from robbie_mp.base.visible_text import visible
from robbie_mp.run.profile.model import TraceSettings
from robbie_mp.run.trace.channel import LogRecord, parse_line
from robbie_mp.run.trace.crash import CrashReport, report_name, report_place
from robbie_mp.run.trace.disk_writer import MAX_FLUSH_S, DiskWriter
from robbie_mp.run.trace.entry import Entry, EntryNumbers
from robbie_mp.run.trace.kinds import ALL_KINDS, KIND_OF_STREAM, Kind, kind_of_level

LOG = "log"
ERRORS = "errors"
"""Log records of this level have a separate rate limit."""
SUPERVISOR = "supervisor"
REPORT_PERIOD_S = 1.0
SHOWN_LINES = 40
STALLED_AFTER_S = 5.0
"""A disk that has accepted nothing for this long is reported as stalled."""
REFUSED_PERIOD_S = 60.0
"""A disk that refuses, for example because it is full, is reported this often."""
ADVICE = "choose another output directory"

Listener = Callable[[Entry], None]


class LogNotWritable(RobbieError, OSError):
    """The folder for log files cannot be made, or cannot be written to."""


class OutputStore:
    """The outputs of all children of a run.

    Attributes:
        disk: writes them, and all other files of the supervisor.
    """

    def __init__(
        self,
        folder: Path,
        listener: Listener = lambda entry: None,
        limits: TraceSettings | None = None,
        disk: DiskWriter | None = None,
    ):
        """Prepare for children.

        Args:
            folder: receives the files of each child.
            listener: called with each entry that is kept, in the supervisor's thread; must not block.
            limits: how much is kept of each child.
            disk: writes the files; the caller closes it. None: a new writer, which `close` closes.

        Raises:
            LogNotWritable: the folder cannot be made or written to.
        """
        try:
            make_private_folder(folder)
        except OSError as error:
            raise LogNotWritable(
                f"cannot make the log folder {folder}: {error.strerror}; {ADVICE}"
            ) from error
        if not os.access(folder, os.W_OK | os.X_OK):
            raise LogNotWritable(f"cannot write to the log folder {folder}: no permission; {ADVICE}")
        self.folder = folder
        self.limits = limits or TraceSettings()
        self.remarked_kinds = ALL_KINDS
        """The kinds of the supervisor's remarks that are recorded."""
        self._listener = listener
        self._numbers = EntryNumbers()
        self._stalled_since_s: float | None = None
        self._told_refused, self._tell_refused_s = 0, 0.0
        self._owns_disk = disk is None
        self.disk = disk or DiskWriter(self.limits.waiting_bytes)
        self.disk.on_restart = lambda: self._open("")  # a replacement writer continues the page
        self._open("begin a page")

    def child(self, name: str, kinds: Collection[Kind] = ALL_KINDS) -> "ChildOutput":
        """Return the output of a new child, with the kinds of entries to record."""
        return ChildOutput(name, self, kinds)

    def number(self) -> int:
        """Return the number of the next entry."""
        return self._numbers.next()

    def write(self, name: str, entries: list[Entry], on_done: Callable[[bool], None]) -> None:
        """Have entries written to a child's file and to the page, and show them."""
        self.disk.order(["entries", name], b"".join([entry.to_line() for entry in entries]), on_done)
        for entry in entries:
            self._listener(entry)

    def write_report(self, report: CrashReport, on_done: Callable[[bool], None]) -> str:
        """Have a crash report written; return its path below the folder."""
        self.disk.order(["report", report.module, report_name(report)], report.to_json(), on_done)
        return report_place(report)

    def turn(self) -> str:
        """Continue writing; called in every iteration of the supervisor's loop.

        Returns:
            News about the disk: that it refuses, has stalled or recovered; usually ''.
        """
        self.disk.turn()
        stalled_s = self.disk.stalled_s
        if self._stalled_since_s is None and stalled_s >= STALLED_AFTER_S:
            self._stalled_since_s = time.monotonic() - stalled_s
            return (
                f"the disk of {self.folder} has stalled: it has accepted nothing for {stalled_s:.1f} s. "
                f"Up to {self.limits.waiting_bytes} bytes of the trace wait; beyond that, entries are dropped"
            )
        if self._stalled_since_s is not None and stalled_s < STALLED_AFTER_S:
            lasted_s = time.monotonic() - self._stalled_since_s
            self._stalled_since_s = None
            return f"the disk of {self.folder} has recovered after {lasted_s:.1f} s"
        return self._news_of_refusals()

    def _news_of_refusals(self) -> str:
        number = self.disk.refused - self._told_refused
        if not number or time.monotonic() < self._tell_refused_s:
            return ""
        self._told_refused = self.disk.refused
        self._tell_refused_s = time.monotonic() + REFUSED_PERIOD_S
        pieces = "1 piece of it is" if number == 1 else f"{number} pieces of it are"
        return f"{self.folder} does not take what the run writes ({self.disk.refusal}): {pieces} lost"

    def flush(self, limit_s: float = MAX_FLUSH_S) -> bool:
        """Wait until all is written; return False if the disk accepts nothing for `limit_s`."""
        return self.disk.flush(limit_s)

    def close(self) -> None:
        """Wait until all is written, as long as the disk accepts data."""
        if self._owns_disk:
            self.disk.close()
        else:
            self.disk.flush()

    def _open(self, begin_page: str) -> None:
        names = ("file_bytes", "files", "page_bytes", "pages", "crash_reports")
        bounds = {name: getattr(self.limits, name) for name in names}
        self.disk.order(["trace", str(self.folder.absolute()), begin_page], json.dumps(bounds).encode())


class ChildOutput:
    """The output of one child over all its incarnations.

    Each stream has its own rate limit, so a flood on standard output does not displace a traceback.

    Attributes:
        limits: how much is kept.
        kinds: the kinds of entries that are recorded; others are neither written nor counted.
        lines: number of entries kept.
        dropped: number of entries dropped: beyond the rate limit, because the disk refused them or has
            stalled, or by the child itself because its log channel was full.
    """

    def __init__(
        self,
        name: str,
        store: OutputStore,
        kinds: Collection[Kind],
    ):
        self.limits = limits = store.limits
        self.kinds = frozenset(kinds)
        self.lines = 0
        self.dropped = 0
        self._name = name
        self._store = store
        self._incarnation = 0
        self._unreported = 0
        self._reported_s = 0.0
        self._rates = {
            stream: TokenBucket(limits.lines_per_s, limits.burst_lines)
            for stream in (*KIND_OF_STREAM, LOG, ERRORS)
        }
        self._last = {stream: deque[str](maxlen=limits.kept_lines) for stream in KIND_OF_STREAM}

    @property
    def last_lines(self) -> tuple[str, ...]:
        """The last lines of the current incarnation's log and standard error; if none, of standard output."""
        return tuple(self._last["stderr"] or self._last["stdout"])[-SHOWN_LINES:]

    def begin(self, incarnation: int) -> None:
        """Forget the last lines of the previous incarnation."""
        self._incarnation = incarnation
        for lines in self._last.values():
            lines.clear()

    def add(self, stream: str, texts: list[str]) -> bool:
        """Keep these printed lines, up to the rate limit; return False if some were dropped."""
        # The last lines of a flood are kept too: they tell why the child ended.
        self._last[stream].extend(map(visible, texts[-self.limits.kept_lines :]))
        kind = KIND_OF_STREAM[stream]
        allowed = self._rates[stream].take(len(texts))
        if kind in self.kinds:
            self._report_dropped_periodically(bool(allowed))
            now_s = time.time()
            self._write([self._entry(now_s, kind, stream, text) for text in texts[:allowed]])
            self._drop(len(texts) - allowed)
        return allowed == len(texts)

    def add_records(self, lines: list[bytes]) -> bool:
        """Keep these log records, up to the rate limit; return False if some were dropped."""
        is_within = True
        kept = []
        now_s = time.time()
        for line in lines:
            entry = self._entry_of(line, now_s)
            if entry is None:
                continue
            self._last["stderr"].extend(entry.lines())
            is_error = entry.kind is Kind.ERROR
            # A long record counts as several lines, as it would if it were printed.
            cost = 1 + len(line) // self.limits.line_characters
            is_allowed = self._rates[ERRORS if is_error else LOG].take(cost) == cost
            is_within = is_within and is_allowed
            if entry.kind in self.kinds:
                if is_allowed:
                    kept.append(entry)
                else:
                    self._drop(1)
        self._write(kept)  # first, because their numbers are lower than that of the remark
        self._report_dropped_periodically(bool(kept))
        return is_within

    def say(self, kind: Kind, text: str) -> None:
        """Add a remark of the supervisor about this child."""
        if kind in self._store.remarked_kinds:
            self._write([self._entry(time.time(), kind, SUPERVISOR, text)])

    def report_crash(self, report: CrashReport) -> CrashReport:
        """Complete the report of an abnormal end with the last lines, write it, and add an entry about it."""
        report = replace(report, said=list(self._last["stderr"]), printed=list(self._last["stdout"]))
        place = self._store.write_report(report, lambda is_done: self._drop_unwritten(not is_done))
        where = f" in {report.last_words.activity}" if report.last_words.activity else ""
        text = f"crashed{where}: {report.reason}"
        detail = "\n".join(report.lines())
        entry = self._entry(time.time(), Kind.ERROR, SUPERVISOR, text, traceback=detail, crash_report=place)
        self._write([entry])
        return report

    def report_dropped(self) -> None:
        """Log how many lines were dropped since the last such entry, if any."""
        if self._unreported:
            rate = f"more than {self.limits.lines_per_s:g} lines/s"
            text = f"{self._unreported} lines dropped: too many at once ({rate})"
            self._unreported = 0
            self._reported_s = time.monotonic()
            self._write([self._entry(time.time(), Kind.WARNING, SUPERVISOR, text)])

    def close(self) -> None:
        """Log how many lines were dropped."""
        self.report_dropped()

    def _report_dropped_periodically(self, is_flood_over: bool) -> None:
        if is_flood_over and time.monotonic() - self._reported_s >= REPORT_PERIOD_S:
            self.report_dropped()

    def _drop(self, count: int) -> None:
        self.dropped += count
        self._unreported += count

    def _entry_of(self, line: bytes, now_s: float) -> Entry | None:
        parsed = parse_line(line, now_s)
        if parsed is None:
            return self._entry(now_s, Kind.ERROR, LOG, f"a damaged log record: {line[:60]!r}")
        self._drop(parsed.dropped)
        return self._entry_of_record(parsed.record) if parsed.record else None

    def _entry_of_record(self, record: LogRecord) -> Entry:
        return self._entry(
            record.time_s,
            kind_of_level(record.level),
            LOG,
            record.text,
            logger=visible(record.logger),
            level=visible(record.level_name),
            where=visible(record.where),
            thread=visible(record.thread),
            traceback=visible(record.traceback),
        )

    def _entry(self, time_s: float, kind: Kind, stream: str, text: str, **more: str) -> Entry:
        number = self._store.number()
        time_s = round(time_s, 6)
        return Entry(number, time_s, kind, self._name, self._incarnation, stream, visible(text), **more)

    def _write(self, entries: list[Entry]) -> None:
        if not entries:
            return
        self.lines += len(entries)
        count = len(entries)
        self._store.write(self._name, entries, lambda is_done: self._drop_unwritten(0 if is_done else count))

    def _drop_unwritten(self, count: int) -> None:
        self.dropped += count
