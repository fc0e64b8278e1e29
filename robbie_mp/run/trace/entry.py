"""One entry of the trace, and the JSON line that stores it."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from typing_extensions import Self

from robbie_mp.run.trace.kinds import Kind


@dataclass(frozen=True, slots=True)
class Entry:
    """Something that a process logged or printed, or a remark of the supervisor. May have several lines."""

    number: int
    """Increases in the order in which the supervisor received the entries; about Unix time in µs."""
    time_s: float
    """Unix time in s: when a log record was made, or when printed lines were read."""
    kind: Kind
    module: str
    incarnation: int
    stream: str
    """"log", "stdout" or "stderr": where it came from; "supervisor" for its remarks about the module."""
    text: str
    """Without the end of line; control characters are escaped."""
    logger: str = ""
    """Name of the logger. This and the following fields are set for log records only."""
    level: str = ""
    where: str = ""
    """File and line of the call."""
    thread: str = ""
    """Empty for the main thread."""
    traceback: str = ""
    crash_report: str = ""
    """If this entry is about a crash: the report's file, relative to the folder of the trace."""

    def lines(self) -> list[str]:
        """Return the entry as a terminal shows it: level of a log record, text, and traceback."""
        text = f"{self.level} {self.text}" if self.level else self.text
        return (f"{text}\n{self.traceback}" if self.traceback else text).split("\n")

    def to_line(self) -> bytes:
        """Return the entry as a line of ASCII JSON, without < and > so that it can be embedded in HTML."""
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
        """Return the entry in a line from `to_line`; None for anything else, such as a partial line."""
        try:
            data: dict[str, Any] = json.loads(line)
            return cls(**(data | {"kind": Kind(data["kind"])}))
        except (ValueError, TypeError, KeyError, RecursionError):
            return None


_ENCODER = json.JSONEncoder(separators=(",", ":"))  # json.dumps would create one for each call
_OPTIONAL = tuple(field.name for field in fields(Entry))[7:]


class EntryNumbers:
    """Numbers that increase even if the clock is set back, and continue in the next run."""

    def __init__(self, wall_clock: Callable[[], float] = time.time):
        self._wall_clock = wall_clock
        self._last = 0

    def next(self) -> int:
        """Return a number higher than all before."""
        self._last = max(self._last + 1, int(self._wall_clock() * 1e6))
        return self._last
