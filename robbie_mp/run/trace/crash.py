"""Crash reports: one JSON file for each abnormal end of a process, in a folder of the trace."""

import json
import re
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from typing_extensions import Self

from robbie_mp.base.linux.private_files import make_private_folder, write_private
from robbie_mp.base.utc import time_text
from robbie_mp.base.visible_text import visible

CRASH_FOLDER = "crashes"
_FILE = re.compile(r"(?P<module>.+)-\d{8}T\d{6}\.\d{3}-\d+\.json")
_BEGIN_OF_TRACEBACK = ("CRITICAL ", "Fatal Python error: ", "Traceback (most recent call last):")


@dataclass(frozen=True)
class LastMessage:
    """The last message that a module took."""

    type_name: str
    topic: str
    sequence: int
    sender: str
    age_s: float
    """From its publication to the end of the process."""


@dataclass(frozen=True)
class LastWords:
    """The data of a process in shared memory."""

    activity: str = ""
    """Its activity, such as "handler on_scan of sensor_msgs/msg/LaserScan"."""
    activity_s: float = 0.0
    """For how long."""
    message: LastMessage | None = None
    counters: dict[str, int] = field(default_factory=dict)
    status: str = ""


@dataclass(frozen=True)
class CrashReport:
    """Everything that is known about one abnormal end."""

    module: str
    incarnation: int
    pid: int
    time_s: float
    """Unix time."""
    uptime_s: float
    reason: str
    """Description in words, such as "killed by SIGSEGV"."""
    exit_code: int | None
    signal: int | None
    cpu_s: float
    hints: list[str]
    """Possible causes, such as lack of memory."""
    last_words: LastWords
    said: list[str]
    """The last lines that it logged or printed on standard error, including stack dumps."""
    printed: list[str]
    """The last lines on standard output."""

    @property
    def traceback(self) -> list[str]:
        """The traceback, from Python or faulthandler; empty if there is none."""
        for begin in _BEGIN_OF_TRACEBACK:
            for at in range(len(self.said) - 1, -1, -1):
                if self.said[at].startswith(begin):
                    return self.said[at:]
        return []

    def lines(self) -> list[str]:
        """Return the report as text to read."""
        stamp = time_text(self.time_s)
        words = self.last_words
        made = [
            f"{self.module}, start {self.incarnation}, pid {self.pid}: {self.reason}",
            f"ended {stamp}, {self.uptime_s:.3f} s after its start; {self.cpu_s:.2f} s on a processor",
            *self.hints,
        ]
        if words.activity:
            made.append(f"it was in {words.activity}, for {words.activity_s:.3f} s")
        if (message := words.message) is not None:
            topic = f" on {message.topic}" if message.topic else ""
            made.append(
                f"last message: {message.type_name}{topic}, number {message.sequence}, "
                f"published by {message.sender} {message.age_s:.3f} s before the end"
            )
        if words.status:
            made.append(f"status: {words.status}")
        if words.counters:
            made.append(", ".join(f"{name} {count}" for name, count in words.counters.items()))
        for title, lines in (("logged, and printed on standard error", self.said), ("printed", self.printed)):
            if lines:
                made += [f"last {title}:", *(f"    {line}" for line in lines)]
        return [visible(line) for line in made]

    def to_json(self) -> bytes:
        """Return the report as `from_json` reads it."""
        return json.dumps(asdict(self), indent=1).encode() + b"\n"

    @classmethod
    def from_json(cls, text: str) -> Self | None:
        """Return the report in a text; None if it is not a report."""
        try:
            data: dict[str, Any] = json.loads(text)
            words = data["last_words"]
            message = words["message"]
            words["message"] = LastMessage(**message) if message else None
            return cls(**(data | {"last_words": LastWords(**words)}))
        except (ValueError, TypeError, KeyError):
            return None


class CrashFolder:
    """The crash reports of a run; only the newest of each process are kept."""

    def __init__(self, folder: Path, keep: int):
        """Prepare; the folder is made with the first report.

        Args:
            folder: the folder of the trace.
            keep: how many reports of each process to keep.
        """
        self._folder = folder / CRASH_FOLDER
        self._keep = keep

    def keep(self, module: str, name: str, data: bytes) -> None:
        """Write a report from `CrashReport.to_json` and remove old ones.

        Raises:
            OSError: the disk refuses.
        """
        make_private_folder(self._folder)
        write_private(self._folder / name, data)
        for old in report_files(self._folder.parent, module)[: -self._keep]:
            old.unlink(missing_ok=True)


def report_name(report: CrashReport) -> str:
    """Return the name of a report's file."""
    seconds, milliseconds = divmod(int(report.time_s * 1000), 1000)
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(seconds))
    return f"{report.module}-{stamp}.{milliseconds:03d}-{report.incarnation}.json"


def report_place(report: CrashReport) -> str:
    """Return the path of a report, relative to the folder of the trace."""
    return f"{CRASH_FOLDER}/{report_name(report)}"


def report_files(folder: Path, module: str | None = None) -> list[Path]:
    """Return the files of the reports in a trace, oldest first.

    Args:
        folder: the folder of the trace.
        module: only reports of this process; None: of all.
    """
    found = []
    for path in (folder / CRASH_FOLDER).glob("*.json"):
        match = _FILE.fullmatch(path.name)
        if match and module in (None, match["module"]):
            found.append((path.name.removeprefix(match["module"]), path))
    return [path for _, path in sorted(found)]
