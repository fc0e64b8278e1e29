"""What children print: written to log files, shown, and the last of it remembered.

What is beyond the bound of lines per second is thrown away and counted.
"""

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.errors import RobbieError
from robbie_mp.supervisor.rate_limit import RateLimit
from robbie_mp.supervisor.rotating_file import RotatingFile

STREAMS = ("stdout", "stderr")
REPORT_EVERY_S = 1.0
# What a terminal would obey; an escape sequence in a log is an attack or an accident.
VISIBLE = {code: f"\\x{code:02x}" for code in (*range(0x20), *range(0x7F, 0xA0)) if code != ord("\t")}


ADVICE = "choose another output directory"


class LogNotWritable(RobbieError, OSError):
    """The folder for log files is of no use: no such place, or no permission."""


@dataclass(frozen=True)
class OutputLimits:
    """Bounds of what is kept of each child's output."""

    file_bytes: int = 4 << 20
    files: int = 3
    lines_per_s: float = 1000.0
    """Of each stream, and of `burst_lines` at once."""
    burst_lines: int = 5000
    line_characters: int = 4096
    """A longer line is cut into several."""
    kept_lines: int = 40
    """Of the current incarnation, in memory."""


@dataclass(frozen=True)
class OutputLine:
    """One line that a child printed."""

    name: str
    incarnation: int
    stream: str
    """"stdout", "stderr", or "supervisor" for a remark about the output."""
    wall_time_s: float
    """Unix time at which it was read."""
    text: str
    """Without its end of line; control characters are escaped."""


class OutputStore:
    """The outputs of all children of a run."""

    def __init__(
        self,
        folder: Path,
        listener: Callable[[OutputLine], None] = lambda line: None,
        limits: OutputLimits = OutputLimits(),
    ):
        """Prepare for children.

        Args:
            folder: gets one log file a child.
            listener: called with each line that is kept, in the supervisor's thread; must not block.
            limits: what is kept of each child.

        Raises:
            LogNotWritable: the folder cannot be made or written to.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise LogNotWritable(
                f"cannot make the log folder {folder}: {error.strerror}; {ADVICE}"
            ) from error
        if not os.access(folder, os.W_OK | os.X_OK):
            raise LogNotWritable(f"cannot write to the log folder {folder}: no permission; {ADVICE}")
        self.folder = folder
        self.listener = listener
        self.limits = limits

    def child(self, name: str) -> "ChildOutput":
        """Return the output of a new child."""
        file = RotatingFile(self.folder / f"{name}.log", self.limits.file_bytes, self.limits.files)
        return ChildOutput(name, file, self.listener, self.limits)


class ChildOutput:
    """The output of one child over all its incarnations.

    Its streams have a rate each, so that a flood on standard output does not drown a traceback.

    Attributes:
        limits: what is kept.
        lines: how many lines were kept so far.
        dropped: how many were thrown away so far, beyond the rate or because the disk refused them.
    """

    def __init__(
        self, name: str, file: RotatingFile, listener: Callable[[OutputLine], None], limits: OutputLimits
    ):
        self.limits = limits
        self.lines = 0
        self.dropped = 0
        self._name = name
        self._file = file
        self._listener = listener
        self._incarnation = 0
        self._unreported = 0
        self._reported_s = 0.0
        self._rates = {stream: RateLimit(limits.lines_per_s, limits.burst_lines) for stream in STREAMS}
        self._last = {stream: deque[str](maxlen=limits.kept_lines) for stream in STREAMS}

    @property
    def last_lines(self) -> tuple[str, ...]:
        """The end of what the current incarnation printed: on standard error if it did, else on output."""
        return tuple(self._last["stderr"] or self._last["stdout"])

    def begin(self, incarnation: int) -> None:
        """Forget the last lines of the former incarnation."""
        self._incarnation = incarnation
        for lines in self._last.values():
            lines.clear()

    def add(self, stream: str, texts: list[str]) -> bool:
        """Keep these lines as far as the rate allows; False if it did not allow all."""
        # Even of a flood, for its end tells why the child ended.
        self._last[stream].extend(map(_visible, texts[-self.limits.kept_lines :]))
        allowed = self._rates[stream].take(len(texts))
        if allowed and time.monotonic() - self._reported_s >= REPORT_EVERY_S:
            self.report_dropped()
        self._write([self._line(stream, text) for text in texts[:allowed]])
        self._drop(len(texts) - allowed)
        return allowed == len(texts)

    def report_dropped(self) -> None:
        """Say in the log how many lines were dropped since this was last said, if any."""
        if self._unreported:
            text = f"{self._unreported} lines dropped: more than {self.limits.lines_per_s:g} lines/s"
            self._unreported = 0
            self._reported_s = time.monotonic()
            self._write([self._line("supervisor", text)])

    def close(self) -> None:
        """Close the log file."""
        self.report_dropped()
        self._file.close()

    def _drop(self, count: int) -> None:
        self.dropped += count
        self._unreported += count

    def _line(self, stream: str, text: str) -> OutputLine:
        return OutputLine(self._name, self._incarnation, stream, time.time(), _visible(text))

    def _write(self, lines: list[OutputLine]) -> None:
        if not lines:
            return
        self.lines += len(lines)
        if not self._file.write("".join(map(_log_entry, lines)).encode()):
            self.dropped += len(lines)
        for line in lines:
            self._listener(line)


def _visible(text: str) -> str:
    return text if text.isprintable() else text.translate(VISIBLE)


def _log_entry(line: OutputLine) -> str:
    seconds, milliseconds = divmod(int(line.wall_time_s * 1000), 1000)
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    return f"{stamp}.{milliseconds:03d}Z #{line.incarnation} {line.stream} {line.text}\n"
