"""Estimates how large an export will be, and asks before it writes much."""

import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from robbie_mp.attached.views import quantities
from robbie_mp.base.balance import Balance
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli.export_forms import Form, MeasuredFiles, Rows
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.logs.recording.reader import Log, LogChannel, channel_name
from robbie_mp.messages import Message

ASKED_BYTES = 1 << 30
"""An export that may be larger is asked for."""
SAMPLE = 10
"""Messages of a channel by whose size the others are estimated."""
NAMED = 3


class ExportTooLarge(LogError, ValueError):
    """An export would be large, and there is no terminal on which to ask.

    Example scenarios:
      - a script exports a log with camera images as tables
    """


def sizes(log: Log, types: Mapping[LogChannel, type[Message]], form: Form) -> dict[LogChannel, int]:
    """Return about how many bytes each channel takes in a form, by its first messages."""
    return {channel: _size(log, channel, message_type, form) for channel, message_type in types.items()}


def _size(log: Log, channel: LogChannel, message_type: type[Message], form: Form) -> int:
    few, many = (_measured(log, channel, message_type, form, most) for most in (SAMPLE // 2, SAMPLE))
    more = max(0, log.counts[channel] - SAMPLE)
    return many + max(0, many - few) * more // (SAMPLE - SAMPLE // 2)


def _measured(log: Log, channel: LogChannel, message_type: type[Message], form: Form, most: int) -> int:
    files = MeasuredFiles()
    form.write(Rows(log, channel, message_type, Balance(), lambda: None, most), files, "")
    return files.size


def is_wanted(folder: Path, found: Mapping[LogChannel, int], *, yes: bool) -> bool:
    """Return whether to write an export; if it is large, the user is asked.

    Args:
        folder: where it would be written.
        found: about how many bytes each channel takes.
        yes: do not ask.

    Raises:
        ExportTooLarge: it is large, and there is no terminal.
    """
    total = sum(found.values())
    if yes or total <= ASKED_BYTES:
        return True
    text = f"{one_line(str(folder))} will take about {quantities.size(total)}B{_where(folder, found)}"
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise ExportTooLarge(f"{text}; --yes writes it, --topics less, --png images as pictures")
    print(f"{text}. Write it? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().casefold() in ("y", "yes")


def _where(folder: Path, found: Mapping[LogChannel, int]) -> str:
    """Return which channels are the largest, and how much room there is."""
    largest = sorted(found, key=lambda channel: -found[channel])[:NAMED]
    shares = ", ".join(f"{one_line(channel_name(one))} {quantities.size(found[one])}B" for one in largest)
    existing = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
    return f" ({shares}; {quantities.size(shutil.disk_usage(existing).free)}B are free)"
