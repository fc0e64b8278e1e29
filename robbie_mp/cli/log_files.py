"""Arguments for recordings and topics, and progress bars for commands that read recordings."""

import argparse
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import TextIO

from robbie_mp.base.balance import Balance
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli import completers
from robbie_mp.cli.amounts import size_between
from robbie_mp.cli.output import PlainConsole, warn
from robbie_mp.logs.recording.limits import MEGABYTE, READ_LIMITS, ReadLimits
from robbie_mp.logs.recording.reader import LogChannel, channel_name, select
from robbie_mp.logs.recording.repair import Progress, unwatched

SHOWN_AFTER_S = 1.0
"""A command that takes less shows no progress bar."""
REFRESH_S = 0.1
METAVARS = {"log": "RECORDING", "logs": "RECORDING"}
LEFT_OUT = 1
"""Exit code of a command that left something out."""


def add_log_argument(parser: argparse.ArgumentParser, name: str = "log", nargs: str | None = None) -> None:
    """Add an argument that names a recording."""
    text = "recording: an MCAP file, or a folder of parts"
    argument = parser.add_argument(
        name, metavar=METAVARS.get(name, name.upper()), type=Path, nargs=nargs, help=text
    )
    argument.completer = completers.logs  # type: ignore[attr-defined]


def add_limit_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that limits the chunks of a recording."""
    parser.add_argument(
        "--max-chunk",
        type=_limits,
        default=READ_LIMITS,
        dest="limits",
        metavar="SIZE",
        help=f"refuse larger chunks (decompressed) and records ({READ_LIMITS.chunk_bytes // MEGABYTE}M)",
    )


def _limits(text: str) -> ReadLimits:
    return ReadLimits(chunk_bytes=size_between(MEGABYTE, MEGABYTE << 20)(text))


@contextmanager
def progress_bar(text: str) -> Iterator[Progress]:
    """Show on a terminal how far a command is and how long the rest takes; yield what updates it.

    Args:
        text: a description of the command's activity.
    """
    if not sys.stderr.isatty():
        yield unwatched
        return
    from rich.progress import Progress as ProgressBar  # noqa: PLC0415

    bar = ProgressBar(console=PlainConsole(sys.stderr), transient=True)
    task = bar.add_task(text, total=None)
    begin = Timer(SHOWN_AFTER_S, bar.start)
    begin.start()
    try:
        yield _seldom(lambda done, total: bar.update(task, completed=done, total=total))
    finally:
        begin.cancel()
        begin.join()
        if bar.live.is_started:
            bar.stop()


def _seldom(update: Progress) -> Progress:
    """Return what updates a bar as often as one can see it: an update takes longer than some messages."""
    next_s = 0.0

    def update_seldom(done: int, total: int) -> None:
        nonlocal next_s
        if (now_s := time.monotonic()) >= next_s:
            next_s = now_s + REFRESH_S
            update(done, total)

    return update_seldom


def add_topics_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that selects topics of a recording."""
    topics = parser.add_argument(
        "--topics",
        nargs="+",
        default=[],
        metavar="PATTERN",
        help="use only these topics (shell patterns); messages without a topic go by their short type name",
    )
    topics.completer = completers.log_topics  # type: ignore[attr-defined]


def warn_of_unmatched(channels: Iterable[LogChannel], patterns: Sequence[str]) -> None:
    """Warn of patterns that match no channel."""
    known = list(channels)
    for pattern in select(known, patterns)[1]:
        names = ", ".join(sorted({channel_name(channel) for channel in known})) or "none"
        warn(f"no topic matches {pattern!r}; there are: {names}")


def add_strict_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that makes any loss an error."""
    parser.add_argument(
        "--strict", action="store_true", help="fail rather than leave out what cannot be read or written"
    )


def print_balance(where: Path, balance: Balance, unit: str = "messages", file: TextIO | None = None) -> int:
    """Print what was used and left out, and return the exit code: 0 if nothing was left out.

    Args:
        where: the file that was read or written.
        balance: what became of its contents.
        unit: what the balance counts.
        file: for the total; by default standard output.
    """
    total, *reasons = balance.lines(unit)
    for reason in reasons:
        warn(reason)
    print(f"{one_line(str(where))}: {total}", file=file)
    return LEFT_OUT if balance.left_out else 0
