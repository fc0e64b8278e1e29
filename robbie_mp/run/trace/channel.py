"""The log channel: carries structured log records from a child to the supervisor, as JSON lines in a pipe.

The child inherits the writing end; the variable `ROBBIE_LOG_CHANNEL` holds its number. A child never waits
for the supervisor. A record that does not fit into the pipe is counted; the next record carries the count.
Part of the pipe is reserved for errors, because they tell why a child ends.
"""

import array
import contextlib
import fcntl
import json
import logging
import os
import termios
import threading
from dataclasses import dataclass
from typing import Any

from robbie_mp.base.linux.forks import keep_from_forks

CHANNEL_VARIABLE = "ROBBIE_LOG_CHANNEL"
CAPACITY_BYTES = 1 << 20
"""The most that an unprivileged process may set (fs.pipe-max-size); enough for thousands of records."""
LINE_BYTES = 1 << 15
TEXT_CHARACTERS = 4096
TRACEBACK_CHARACTERS = 12288
_ENCODER = json.JSONEncoder(ensure_ascii=False)  # json.dumps would create one for each call


def open_channel() -> tuple[int, int]:
    """Return the supervisor's end and the child's end of a new channel, both non-blocking."""
    reader, writer = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)
    with contextlib.suppress(OSError):  # the pipes of one user together have a limit too
        fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, CAPACITY_BYTES)
    return reader, writer


class ChannelHandler(logging.Handler):
    """Sends log records to the supervisor.

    Attributes:
        dropped: number of records that did not fit and are not reported yet.
    """

    def __init__(self, fd: int):
        super().__init__()
        self._fd = fd
        self._capacity_bytes = fcntl.fcntl(fd, fcntl.F_GETPIPE_SZ)
        self._waiting_bytes = array.array("i", [0])
        self._rest = b""
        """The rest of a line that fitted only partly."""
        self.dropped = 0
        keep_from_forks(self)

    def disown(self) -> None:
        """In a forked process: start with a new line. The parent sends the rest of the last one."""
        self._rest = b""
        self.dropped = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record, or count it if it does not fit."""
        try:
            line = self._line(record)
        except Exception as error:  # its arguments do not match its format, which logging allows
            text = (
                f"a log call at {record.pathname}:{record.lineno} has a text and arguments that do not match"
            )
            written = record.msg if isinstance(record.msg, str) else type(record.msg).__name__
            record.msg, record.args = f"{text}: {written!r:.200}: {type(error).__name__}: {error}", ()
            record.levelno, record.levelname = logging.ERROR, "ERROR"
            line = self._line(record)
        if record.levelno < logging.ERROR and self._is_filling():
            self.dropped += 1
        else:
            self.send(line)

    def send(self, line: bytes) -> bool:
        """Send a line; return False if it did not fit and was counted."""
        try:
            if self._rest:
                self._rest = self._rest[os.write(self._fd, self._rest) :]
            written = 0 if self._rest else os.write(self._fd, line)
        except OSError:
            written = 0
        if not written:
            self.dropped += 1
            return False
        self._rest = line[written:]
        self.dropped = 0
        return True

    def close(self) -> None:
        """Send the last count of dropped records; the pipe stays open for other threads that still log."""
        if self.dropped:
            self.send(json.dumps({"dropped": self.dropped}).encode() + b"\n")
        super().close()

    def _is_filling(self) -> bool:
        fcntl.ioctl(self._fd, termios.FIONREAD, self._waiting_bytes)
        return self._waiting_bytes[0] > self._capacity_bytes // 4 * 3

    def _line(self, record: logging.LogRecord) -> bytes:
        data: dict[str, object] = {
            "time_s": record.created,
            "level": record.levelno,
            "level_name": record.levelname,
            "logger": record.name,
            "where": f"{record.filename}:{record.lineno}",
        }
        if record.threadName != threading.main_thread().name:
            data["thread"] = record.threadName
        if self.dropped:
            data["dropped"] = self.dropped
        text, trace = record.getMessage(), _traceback(record)
        line, longest = b"", TEXT_CHARACTERS
        while not line or len(line) >= LINE_BYTES:
            data["text"] = _head(text, longest)
            if trace:
                data["traceback"] = _tail(trace, longest * TRACEBACK_CHARACTERS // TEXT_CHARACTERS)
            # A lone surrogate is valid in a Python string; escaped like this it is valid in JSON too.
            line = _ENCODER.encode(data).encode(errors="backslashreplace")
            longest //= 2
        return line + b"\n"


def log_to_supervisor() -> ChannelHandler | None:
    """Send this process's log records to the supervisor; return None if it has no log channel.

    Warnings of the `warnings` module and exceptions that end a thread are sent too.
    """
    number = os.environ.pop(CHANNEL_VARIABLE, None)
    if number is None:
        return None
    os.set_inheritable(int(number), False)
    handler = ChannelHandler(int(number))
    logging.getLogger().addHandler(handler)
    logging.captureWarnings(True)
    threading.excepthook = _log_thread_exception
    return handler


def _log_thread_exception(arguments: threading.ExceptHookArgs) -> None:
    if arguments.exc_type is SystemExit or arguments.exc_value is None:
        return
    name = arguments.thread.name if arguments.thread else "?"
    logging.getLogger("threading").error(
        "thread %s ended by an exception",
        name,
        exc_info=(arguments.exc_type, arguments.exc_value, arguments.exc_traceback),
    )


def _traceback(record: logging.LogRecord) -> str:
    parts = []
    if record.exc_info and record.exc_info != (None, None, None):
        parts.append(logging.Formatter().formatException(record.exc_info))
    if record.stack_info:
        parts.append(record.stack_info)
    return "\n".join(parts)


def _head(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]}… ({len(text) - longest} characters cut)"


def _tail(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"({len(text) - longest} characters cut) …{text[-longest:]}"


PLAUSIBLE_S = 3600.0
"""A record's time may differ from the present by this much, because clocks may be set."""


@dataclass(frozen=True)
class LogRecord:
    """A log record as a child sent it."""

    time_s: float
    level: int
    level_name: str
    logger: str
    text: str
    where: str
    thread: str
    traceback: str


@dataclass(frozen=True)
class LogLine:
    """The content of one line of a log channel."""

    record: LogRecord | None
    """None if the line holds only the count."""
    dropped: int
    """Number of records that the child could not send."""


def parse_line(line: bytes, now_s: float) -> LogLine | None:
    """Return the content of a line; None if no `ChannelHandler` made it. The sender is not trusted."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(data, dict):
        return None
    dropped = _count(data.get("dropped"))
    if "text" not in data:
        return LogLine(None, dropped) if dropped else None
    if not (level := _count(data.get("level"))):
        return None
    record = LogRecord(
        time_s=_time(data.get("time_s"), now_s),
        level=level,
        level_name=_text(data, "level_name"),
        logger=_text(data, "logger"),
        text=_text(data, "text"),
        where=_text(data, "where"),
        thread=_text(data, "thread"),
        traceback=_text(data, "traceback"),
    )
    return LogLine(record, dropped)


def _text(data: dict[str, Any], key: str) -> str:
    value = data.get(key, "")
    return value if isinstance(value, str) else ""


def _count(value: object) -> int:
    return value if isinstance(value, int) and 0 <= value < 1 << 32 else 0


def _time(value: object, now_s: float) -> float:
    if isinstance(value, float) and abs(now_s - value) < PLAUSIBLE_S:  # false for NaN
        return value
    return now_s
