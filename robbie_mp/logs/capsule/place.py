"""How and where a module crashed: in a crash report, and in a replay."""

import re
import signal
import traceback
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from typing_extensions import Self

from robbie_mp.run.trace.crash import CrashReport

_FRAME = re.compile(r'(?:  \| )?\s*File "(?P<file>.*)", line (?P<line>\d+),? in (?P<function>.+)')
"""Also one of a group of exceptions, but not those of its members, which are further to the right."""
_ERROR = re.compile(r"CRITICAL (?P<type>[\w.]+): ?(?P<text>.*)", re.DOTALL)
_HANG = re.compile(r".* for \d+(\.\d+)? s: ")
_LIBRARIES = "/lib/python", "/robbie_mp/", "<frozen "
EXCEPTION, SIGNAL, HANG, EXIT, END = "exception", "signal", "hang", "exit", "end"


@dataclass(frozen=True)
class Place:
    """A line of code."""

    file: str
    line: int
    function: str

    def is_like(self, other: "Place | None", *, same_line: bool = True) -> bool:
        """Whether another place is the same, perhaps in another folder."""
        if other is None or Path(self.file).name != Path(other.file).name:
            return False
        is_same = self.function.rpartition(".")[2] == other.function.rpartition(".")[2]
        return is_same and (not same_line or self.line == other.line)

    def __str__(self) -> str:
        return f"{self.file}:{self.line} in {self.function}"


@dataclass(frozen=True)
class Crash:
    """How a module ended.

    Attributes:
        kind: EXCEPTION, SIGNAL, HANG, EXIT or END (it did not crash).
        what: name of the exception or of the signal, or the exit code.
        text: the text of the exception.
        place: where; None: not known.
    """

    kind: str
    what: str = ""
    text: str = ""
    place: Place | None = None

    def is_like(self, other: "Crash", *, same_line: bool = True) -> bool:
        """Whether another crash is the same: its kind, its name and its place."""
        if (self.kind, self.what) != (other.kind, other.what):
            return False
        if self.place is None or other.place is None:
            return self.place is None and other.place is None
        if self.kind == HANG:
            same_line = False  # a loop is interrupted anywhere
        return self.place.is_like(other.place, same_line=same_line)

    def __str__(self) -> str:
        where = f" at {self.place}" if self.place else ""
        match self.kind:
            case "exception":
                return f"{self.what}{f': {self.text}' if self.text else ''}{where}"
            case "hang":
                return f"a hang{where}"
            case "exit":
                return f"exit code {self.what}"
            case "end":
                return "no crash"
        return f"{self.what}{where}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """Return the crash of `to_dict`."""
        place = values.pop("place")
        return cls(**values, place=Place(**place) if place else None)


def reported_crash(report: CrashReport) -> Crash:
    """Return how a module crashed according to its report."""
    trace = report.traceback
    if report.signal is not None:
        name = signal.Signals(report.signal).name if report.signal in set(signal.Signals) else "a signal"
        kind = HANG if _HANG.match(report.reason) else SIGNAL
        return Crash(kind, "" if kind == HANG else name, "", dumped_place(report.said))
    error = _ERROR.match(trace[0]) if trace else None
    if error is None:
        return Crash(EXIT, str(report.exit_code))
    places = [_place(match) for line in trace if (match := _FRAME.match(line))]
    text = error["text"].partition(" (the profile allows memory.")[0]
    return Crash(EXCEPTION, error["type"], text, innermost(places[::-1]))


def raised_crash(error: BaseException) -> Crash:
    """Return the crash that an exception is."""
    frames = traceback.extract_tb(error.__traceback__)
    places = [Place(frame.filename, frame.lineno or 0, frame.name) for frame in frames]
    return Crash(EXCEPTION, type(error).__name__, str(error), innermost(places[::-1]))


def dumped_place(lines: list[str]) -> Place | None:
    """Return where the main thread was when faulthandler printed the stacks: outside of libraries."""
    begin = [number for number, line in enumerate(lines) if line.startswith("Current thread ")]
    if not begin:
        return None
    places = []
    for line in lines[begin[-1] + 1 :]:
        if (match := _FRAME.match(line)) is None:
            break
        places.append(_place(match))
    return innermost(places)


def innermost(places: list[Place]) -> Place | None:
    """Return the place that the author knows, of places from the innermost on: outside of libraries."""
    theirs = (one for one in places if not is_of_library(one.file))
    return next(theirs, places[0] if places else None)


def is_of_library(file: str) -> bool:
    """Whether a file of code is not its author's own."""
    return any(folder in file for folder in _LIBRARIES)


def _place(match: "re.Match[str]") -> Place:
    return Place(match["file"], int(match["line"]), match["function"])
