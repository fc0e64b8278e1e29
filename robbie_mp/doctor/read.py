"""Reads what the kernel says in files."""

from pathlib import Path


def read_line(file: Path) -> str | None:
    """Return the first line of a file, None if there is no such file or it may not be read."""
    try:
        return file.read_text(errors="replace").partition("\n")[0].strip()
    except OSError:
        return None


def read_number(file: Path) -> int | None:
    """Return the number in a file's first line, None if there is none, as where it says `max`."""
    try:
        return int(read_line(file) or "")
    except ValueError:
        return None
