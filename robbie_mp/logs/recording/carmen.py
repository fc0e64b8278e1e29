"""Read a robot's drive from a CARMEN log, the text format of many public laser data sets."""

import bz2
import gzip
import io
import lzma
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from robbie_mp.base.balance import Balance
from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.base.utc import time_text
from robbie_mp.logs.recording.carmen_messages import (
    PLACE_TOPIC,
    LaserPlaces,
    Survey,
    is_offset,
    message_of,
    topic_of,
)
from robbie_mp.logs.recording.carmen_records import (
    FRONT,
    LaserRecord,
    OdometryRecord,
    Record,
    numbers,
    reader_of,
)
from robbie_mp.logs.recording.errors import LogUnreadable, NotALog
from robbie_mp.logs.recording.repair import Progress, unwatched
from robbie_mp.messages import Message
from robbie_mp.messages.well_formed import find_flaw

MAX_LINE_CHARACTERS = 16 << 20
"""Longer than a line with a million beams."""
MAX_KINDS = 100
MAX_PARAMETERS = 10_000
PARAMETER = "PARAM"
COMPRESSIONS: dict[bytes, Callable[[Any], Any]] = {
    b"\x1f\x8b": gzip.open,
    b"BZh": bz2.open,
    b"\xfd7zXZ\0": lzma.open,
}
TOO_LONG = ["line that is too long"]
_KIND = re.compile(r"[A-Z][A-Z0-9_]{1,30}")


class DriveMessage(NamedTuple):
    """A message of a log, when it was published, and its topic."""

    logger_time_s: float
    ipc_time_s: float
    message: Message
    topic: str


@dataclass
class CarmenLog:
    """A log file, also compressed by gzip, bzip2 or xz; iterate over it for its records as recorded.

    Attributes:
        path: the file.
        balance: each reading counts in it the lines that are left out: broken ones, and those of kinds of
            which no record is made. Comments and parameters are not left out.
        bytes_read: how far the last reading has got in the file.
    """

    path: Path
    balance: Balance = field(default_factory=Balance)
    bytes_read: int = 0

    def __iter__(self) -> Iterator[Record]:
        """Read the records. If no line has odometry, the poses in the front laser's lines are odometry.

        Raises:
            NotALog: there is no record, so this is no CARMEN log.
            LeftOut: the balance allows no loss.
            OSError: the file cannot be read.
        """
        has_odometry = self.survey.kinds["ODOM"] > 0
        reasons: dict[str, str] = {}
        is_log = False
        for number, words in self._lines(self.balance):
            record = self._read(number, words, reasons)
            if isinstance(record, LaserRecord) and record.laser == FRONT and not has_odometry:
                yield record.odometry
            if record is not None:
                is_log = True
                yield record
        if not is_log:
            lines = sum(self.survey.kinds.values())
            raise NotALog(f"{self.path} is no CARMEN log: none of its {lines} lines is a record of one")

    def drive(self) -> Iterator[OdometryRecord | LaserRecord]:
        """Read odometry and the sweeps of the front laser only."""
        for record in self:
            if isinstance(record, OdometryRecord) or (
                isinstance(record, LaserRecord) and record.laser == FRONT
            ):
                yield record

    def messages(self) -> Iterator[DriveMessage]:
        """Read the records as messages; first, and whenever they change, come the places of the lasers."""
        places, is_first = LaserPlaces(self.survey), True
        for record in self:
            times = record.logger_time_s, record.ipc_time_s
            if places.change(record) or is_first:
                yield DriveMessage(*times, places.message(), PLACE_TOPIC)
            is_first = False
            message = message_of(record)
            if flaw := find_flaw(message):
                self.balance.leave_out(f"{type(message).__name__} whose {flaw.field} is not {flaw.expected}")
            else:
                yield DriveMessage(*times, message, topic_of(record, self.survey.kinds))

    def check(self) -> dict[str, int]:
        """Read the whole file and return how many records of each kind it has."""
        counts = Counter(type(record) for record in self)
        return {"odometry": counts[OdometryRecord], "laser": counts[LaserRecord]}

    @property
    def parameters(self) -> dict[str, str]:
        """The last value of each `PARAM`, such as `robot_frontlaser_offset`."""
        return self.survey.parameters

    @cached_property
    def survey(self) -> Survey:
        """What is in the log. This reads the whole file, but few of its lines closely."""
        found = Survey(Counter(), {}, {})
        for number, words in self._lines(Balance()):
            kind = _kind(words)
            if words is TOO_LONG and not any(map(reader_of, found.kinds)):
                raise NotALog(
                    f"{self.path}:{number}: the longest line may have {MAX_LINE_CHARACTERS - 1} characters; "
                    "is this a CARMEN log?"
                )
            if kind in found.kinds or len(found.kinds) < MAX_KINDS:
                found.kinds[kind] += 1
            if found.kinds[kind] == 1 or kind == PARAMETER:
                _note(words, found)
        return found

    def _lines(self, balance: Balance) -> Iterator[tuple[int, list[str]]]:
        """Read the words of each line that is no comment, and its number; count an end that is damaged."""
        with open_regular(Path(self.path)) as file, _text(file) as text:
            try:
                for number, line in enumerate(iter(lambda: text.readline(MAX_LINE_CHARACTERS), ""), start=1):
                    self.bytes_read = file.tell()
                    words = line.split() if len(line) < MAX_LINE_CHARACTERS else TOO_LONG
                    if words and not words[0].startswith("#"):
                        yield number, words
            except (EOFError, zlib.error, lzma.LZMAError, OSError) as error:
                if isinstance(error, OSError) and error.errno is not None:
                    raise
                balance.leave_out("end of the file, whose compression is damaged")

    def _read(self, number: int, words: list[str], reasons: dict[str, str]) -> Record | None:
        kind = _kind(words)
        reader = reader_of(kind)
        try:
            if reader is not None:
                return reader(words)
            if kind == PARAMETER:
                _parameter(words)
            else:
                self.balance.leave_out(f"{kind} lines" if kind else "lines that begin with no record's name")
        except ValueError as error:
            first = f"broken {kind} lines; the first is line {number}: {error}"
            self.balance.leave_out(reasons.setdefault(kind, first))
        return None


def describe_carmen(path: Path, progress: Progress = unwatched) -> dict[str, str]:
    """Describe a CARMEN log: labels and texts.

    Args:
        path: the log.
        progress: counts bytes.

    Raises:
        NotALog: the file is none.
        LogUnreadable: the file cannot be read.
    """
    log = CarmenLog(path)
    try:
        size, messages = path.stat().st_size, []
        for one in log.messages():
            messages.append((one.logger_time_s, one.ipc_time_s))
            progress(log.bytes_read, size)
    except OSError as error:
        raise LogUnreadable(f"{path} cannot be read: {error.strerror}") from error
    logger_s, ipc_s = zip(*messages, strict=True)
    left_out = [f"{count} {reason}" for reason, count in log.balance.left_out.items()]
    return {
        "format": "CARMEN log",
        "lines": ", ".join(f"{count} {kind or 'others'}" for kind, count in log.survey.kinds.items()),
        "messages": f"{len(messages)}",
        "duration": f"{max(logger_s) - min(logger_s):.3f} s",
        "from": f"{time_text(min(ipc_s))} to {time_text(max(ipc_s))}",
        "import leaves out": "\n".join(left_out) or "nothing",
    }


def _text(file: BinaryIO) -> io.TextIOWrapper:
    """Return the text in a file that may be compressed."""
    assert isinstance(file, io.BufferedReader)
    head = file.peek(6)
    opened = next((opens(file) for magic, opens in COMPRESSIONS.items() if head.startswith(magic)), file)
    return io.TextIOWrapper(opened, encoding="utf-8-sig", errors="replace")


def _kind(words: list[str]) -> str:
    return words[0] if _KIND.fullmatch(words[0]) else ""


def _note(words: list[str], found: Survey) -> None:
    """Enter a parameter, or the first line of a laser."""
    try:
        if words[0] == PARAMETER:
            name, value = _parameter(words)
            if name in found.parameters or len(found.parameters) < MAX_PARAMETERS:
                found.parameters[name] = value
        elif (reader := reader_of(words[0])) and isinstance(record := reader(words), LaserRecord):
            found.first.setdefault(record.laser, record)
    except ValueError:
        pass  # the reading counts it


def _parameter(words: list[str]) -> tuple[str, str]:
    if len(words) < 3:
        raise ValueError("PARAM should have a name and a value")
    if is_offset(words[1]):
        numbers(words[2:3])
    return words[1], words[2]
