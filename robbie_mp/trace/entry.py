"""One entry of the trace, and the line of JSON it is written as."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Self

from robbie_mp.trace.kinds import Kind


@dataclass(frozen=True, slots=True)
class Entry:
    """One thing that a process said, or the supervisor about it. A text may have several lines."""

    number: int
    """Counts up over the run, in the order in which the supervisor heard of things; about Unix time in µs."""
    time_s: float
    """Unix time: of a log record when it was made, of printed lines when they were read."""
    kind: Kind
    module: str
    incarnation: int
    stream: str
    """"log", "stdout" or "stderr": where it came from; "supervisor" for its remarks about the module."""
    text: str
    """Without its end of line; control characters are escaped."""
    logger: str = ""
    """Name of the logger, of log records. So are the following."""
    level: str = ""
    where: str = ""
    """File and line of the call."""
    thread: str = ""
    """Empty for the main thread."""
    traceback: str = ""
    crash_report: str = ""
    """File of the report, below the folder of the trace, if this entry is about a crash."""

    def lines(self) -> list[str]:
        """Return what a terminal shows: the level of a log record, the text, and the traceback."""
        text = f"{self.level} {self.text}" if self.level else self.text
        return (f"{text}\n{self.traceback}" if self.traceback else text).split("\n")

    def to_line(self) -> bytes:
        """Return the entry as a line of JSON in ASCII, without < and > so that it may stand in HTML."""
        data: dict[str, object] = {
            "number": self.number,
            "time_s": self.time_s,
            "kind": str(self.kind),
            "module": self.module,
            "incarnation": self.incarnation,
            "stream": self.stream,
            "text": self.text,
        }
        data |= {name: value for name in _OPTIONAL if (value := getattr(self, name))}
        text = _ENCODER.encode(data)
        return text.replace("<", "\\u003c").replace(">", "\\u003e").encode() + b"\n"

    @classmethod
    def from_line(cls, line: bytes) -> Self | None:
        """Return what `to_line` wrote; None for anything else, such as half a line."""
        try:
            data: dict[str, Any] = json.loads(line)
            return cls(**(data | {"kind": Kind(data["kind"])}))
        except (ValueError, TypeError, KeyError, RecursionError):
            return None


_ENCODER = json.JSONEncoder(separators=(",", ":"))  # json.dumps would make one each time
_OPTIONAL = tuple(field.name for field in fields(Entry))[7:]


class EntryNumbers:
    """Numbers that count up even when the clock is set back, and go on in the next run."""

    def __init__(self, wall_clock: Callable[[], float] = time.time):
        self._wall_clock = wall_clock
        self._last = 0

    def next(self) -> int:
        """Return a number above all before."""
        self._last = max(self._last + 1, int(self._wall_clock() * 1e6))
        return self._last
