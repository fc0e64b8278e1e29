"""Common parts of all checks: reading the kernel's files, and the finding that a check returns."""

from dataclasses import dataclass
from pathlib import Path

from strenum import StrEnum


class Level(StrEnum):
    """How serious a finding is."""

    OK = "ok"
    WARN = "warn"
    """A robot runs, but not as well or as long as it could."""
    FAIL = "fail"
    """A robot does not run."""


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    check: str
    level: Level
    found: str
    """The result of the check, in words."""
    advice: str = ""
    """Advice to the user; empty if nothing is to be done."""


def ok(check: str, found: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(check, Level.OK, found)


def warn(check: str, found: str, advice: str) -> Finding:
    """Return a finding that something could be better."""
    return Finding(check, Level.WARN, found, advice)


def fail(check: str, found: str, advice: str) -> Finding:
    """Return a finding that a robot would not run."""
    return Finding(check, Level.FAIL, found, advice)


def size(count: float) -> str:
    """Format a number of bytes, such as 64 MiB."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if count < 1024:
            return f"{count:.0f} {unit}" if count >= 10 or unit == "B" else f"{count:.1f} {unit}"
        count /= 1024
    return f"{count:.1f} TiB"


def read_line(file: Path) -> str | None:
    """Return the first line of a file; None if it cannot be read."""
    try:
        return file.read_text(errors="replace").partition("\n")[0].strip()
    except OSError:
        return None


def read_number(file: Path) -> int | None:
    """Return the number in a file's first line; None if there is no number, as in `max`."""
    try:
        return int(read_line(file) or "")
    except ValueError:
        return None
