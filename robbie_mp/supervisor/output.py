"""What children say: entries of the trace, handed over to be written, shown, and the last of it remembered.

Nothing here waits for the disk; see `robbie_mp.trace.disk_writer`. Each child has files of its own, so
that who says much pushes out nobody's lines but its own. What is beyond the bound of lines per second is
thrown away and counted.
"""

import json
import os
import time
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

from robbie_mp.errors import RobbieError
from robbie_mp.linux.private_files import make_private_folder
from robbie_mp.profile.model import TraceSettings
from robbie_mp.trace.channel import LogRecord, parse_line
from robbie_mp.trace.crash import CrashReport, report_name, report_place
from robbie_mp.trace.disk_writer import CLOSE_LIMIT_S, DiskWriter
from robbie_mp.trace.entry import Entry, EntryNumbers
from robbie_mp.trace.kinds import ALL_KINDS, KIND_OF_STREAM, Kind, kind_of_level
from robbie_mp.visible_text import visible


class RateLimit:
    """Lets a burst pass, and then as many lines a second as are allowed (a token bucket)."""

    def __init__(self, lines_per_s: float, burst_lines: int, clock: Callable[[], float] = time.monotonic):
        self._lines_per_s = lines_per_s
        self._burst_lines = float(burst_lines)
        self._clock = clock
        self._allowance = self._burst_lines
        self._updated_s = clock()

    def take(self, count: int) -> int:
        """Return how many of so many lines may pass."""
        now_s = self._clock()
        gained = (now_s - self._updated_s) * self._lines_per_s
        self._updated_s = now_s
        self._allowance = min(self._burst_lines, self._allowance + gained)
        allowed = min(count, int(self._allowance))
        self._allowance -= allowed
        return allowed


LOG = "log"
ERRORS = "errors"
"""Among the log records: they have a rate of their own."""
SUPERVISOR = "supervisor"
REPORT_EVERY_S = 1.0
SHOWN_LINES = 40
STALLED_AFTER_S = 5.0
"""A disk that has taken nothing for so long is said to have stalled."""
ADVICE = "choose another output directory"

Listener = Callable[[Entry], None]


class LogNotWritable(RobbieError, OSError):
    """The folder for log files is of no use: no such place, or no permission."""


class OutputStore:
    """The outputs of all children of a run.

    Attributes:
        disk: what writes them, and whatever else the supervisor has to write.
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
            folder: gets the files of each child.
            listener: called with each entry that is kept, in the supervisor's thread; must not block.
            limits: what is kept of each child.
            disk: what writes, closed by the caller; None: one of our own, closed by `close`.

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
        """Which of the supervisor's remarks are recorded."""
        self._listener = listener
        self._numbers = EntryNumbers()
        self._stalled_since_s: float | None = None
        self._owns_disk = disk is None
        self.disk = disk or DiskWriter(self.limits.waiting_bytes)
        self.disk.on_restart = lambda: self._open("")  # what takes the place of a dead one goes on
        self._open("begin a page")

    def child(self, name: str, kinds: Collection[Kind] = ALL_KINDS) -> "ChildOutput":
        """Return the output of a new child, of which these kinds are recorded."""
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
        """Have the report of a crash written; return its place below the folder."""
        self.disk.order(["report", report.module, report_name(report)], report.to_json(), on_done)
        return report_place(report)

    def turn(self) -> str:
        """Go on writing; called every turn of the supervisor's loop.

        Returns:
            What is to be said of the disk: that it has stalled, or takes something again; mostly ''.
        """
        self.disk.turn()
        stalled_s = self.disk.stalled_s
        if self._stalled_since_s is None and stalled_s >= STALLED_AFTER_S:
            self._stalled_since_s = time.monotonic() - stalled_s
            return (
                f"the disk of {self.folder} has stalled: it has taken nothing for {stalled_s:.1f} s. "
                f"Up to {self.limits.waiting_bytes} bytes of the trace wait; what comes beyond is dropped"
            )
        if self._stalled_since_s is not None and stalled_s < STALLED_AFTER_S:
            lasted_s = time.monotonic() - self._stalled_since_s
            self._stalled_since_s = None
            return f"the disk of {self.folder} takes something again, after {lasted_s:.1f} s"
        return ""

    def flush(self, limit_s: float = CLOSE_LIMIT_S) -> bool:
        """Wait until all is written; False if the disk takes nothing for so long."""
        return self.disk.flush(limit_s)

    def close(self) -> None:
        """Wait for what is still to be written, as long as the disk takes anything."""
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

    Its streams have a rate each, so that a flood on standard output does not drown a traceback.

    Attributes:
        limits: what is kept.
        kinds: which entries are recorded; the others are neither written nor counted.
        lines: how many entries were kept so far.
        dropped: how many were thrown away so far: beyond the rate, because the disk refused them or has
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
            stream: RateLimit(limits.lines_per_s, limits.burst_lines)
            for stream in (*KIND_OF_STREAM, LOG, ERRORS)
        }
        self._last = {stream: deque[str](maxlen=limits.kept_lines) for stream in KIND_OF_STREAM}

    @property
    def last_lines(self) -> tuple[str, ...]:
        """The end of what the current incarnation logged and printed on standard error, else on output."""
        return tuple(self._last["stderr"] or self._last["stdout"])[-SHOWN_LINES:]

    def begin(self, incarnation: int) -> None:
        """Forget the last lines of the former incarnation."""
        self._incarnation = incarnation
        for lines in self._last.values():
            lines.clear()

    def add(self, stream: str, texts: list[str]) -> bool:
        """Keep these printed lines as far as the rate allows; False if it did not allow all."""
        # Even of a flood, for its end tells why the child ended.
        self._last[stream].extend(map(visible, texts[-self.limits.kept_lines :]))
        kind = KIND_OF_STREAM[stream]
        allowed = self._rates[stream].take(len(texts))
        if kind in self.kinds:
            self._report_dropped_now_and_then(bool(allowed))
            now_s = time.time()
            self._write([self._entry(now_s, kind, stream, text) for text in texts[:allowed]])
            self._drop(len(texts) - allowed)
        return allowed == len(texts)

    def add_records(self, lines: list[bytes]) -> bool:
        """Keep these log records as far as the rate allows; False if it did not allow all."""
        is_within = True
        kept = []
        now_s = time.time()
        for line in lines:
            entry = self._entry_of(line, now_s)
            if entry is None:
                continue
            self._last["stderr"].extend(entry.lines())
            is_error = entry.kind is Kind.ERROR
            # A long record counts as often as a printed line of its length would.
            cost = 1 + len(line) // self.limits.line_characters
            is_allowed = self._rates[ERRORS if is_error else LOG].take(cost) == cost
            is_within = is_within and is_allowed
            if entry.kind in self.kinds:
                if is_allowed:
                    kept.append(entry)
                else:
                    self._drop(1)
        self._write(kept)  # first, for their numbers are lower than that of the remark
        self._report_dropped_now_and_then(bool(kept))
        return is_within

    def say(self, kind: Kind, text: str) -> None:
        """Add a remark of the supervisor about this child."""
        if kind in self._store.remarked_kinds:
            self._write([self._entry(time.time(), kind, SUPERVISOR, text)])

    def report_crash(self, report: CrashReport) -> None:
        """Keep the report of an abnormal end, with the last lines, and say so."""
        report = replace(report, said=list(self._last["stderr"]), printed=list(self._last["stdout"]))
        place = self._store.write_report(report, lambda is_done: self._drop_unwritten(not is_done))
        where = f" in {report.last_words.activity}" if report.last_words.activity else ""
        text = f"crashed{where}: {report.reason}"
        detail = "\n".join(report.lines())
        entry = self._entry(time.time(), Kind.ERROR, SUPERVISOR, text, traceback=detail, crash_report=place)
        self._write([entry])

    def report_dropped(self) -> None:
        """Say in the log how many lines were dropped since this was last said, if any."""
        if self._unreported:
            rate = f"more than {self.limits.lines_per_s:g} lines/s"
            text = f"{self._unreported} lines dropped: too many at once ({rate})"
            self._unreported = 0
            self._reported_s = time.monotonic()
            self._write([self._entry(time.time(), Kind.WARNING, SUPERVISOR, text)])

    def close(self) -> None:
        """Say what was dropped."""
        self.report_dropped()

    def _report_dropped_now_and_then(self, is_flood_over: bool) -> None:
        if is_flood_over and time.monotonic() - self._reported_s >= REPORT_EVERY_S:
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
