"""How commands take logs and topics, and how they show that they work on one."""

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from robbie_mp.cli import completers
from robbie_mp.cli.output import PlainConsole, warn
from robbie_mp.recording.conversion import Conversion
from robbie_mp.recording.limits import MEGABYTE, READ_LIMITS, ReadLimits
from robbie_mp.recording.reader import LogChannel
from robbie_mp.recording.repair import Progress
from robbie_mp.recording.selection import channel_name, select


def add_log_argument(parser: argparse.ArgumentParser, name: str = "log", nargs: str | None = None) -> None:
    """Add an argument that names a log."""
    text = "a log: an MCAP file, or a folder of parts"
    argument = parser.add_argument(name, metavar=name.upper(), type=Path, nargs=nargs, help=text)
    argument.completer = completers.logs  # type: ignore[attr-defined]


def add_limit_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option by which commands take how large a chunk of a log may be."""
    parser.add_argument(
        "--max-chunk-mib",
        type=_mebibytes,
        default=READ_LIMITS,
        dest="limits",
        metavar="MIB",
        help=f"largest chunk, decompressed, and largest record ({READ_LIMITS.chunk_bytes // MEGABYTE})",
    )


def _mebibytes(text: str) -> ReadLimits:
    count = int(text)
    if not 1 <= count <= 1 << 20:
        raise argparse.ArgumentTypeError(f"expected 1 to {1 << 20} MiB; got {text}")
    return ReadLimits(chunk_bytes=count * MEGABYTE)


@contextmanager
def progress_bar(text: str) -> Iterator[Progress]:
    """Show on a terminal how far something is; what is yielded is told so.

    Args:
        text: what is done.
    """
    if not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    from rich.progress import Progress as ProgressBar  # noqa: PLC0415

    with ProgressBar(console=PlainConsole(sys.stderr), transient=True) as bar:
        task = bar.add_task(text)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def add_topics_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option by which commands take patterns of topics in a log."""
    topics = parser.add_argument(
        "--topics",
        nargs="+",
        default=[],
        metavar="PATTERN",
        help="shell patterns; for messages without a topic, of the last part of their type",
    )
    topics.completer = completers.log_topics  # type: ignore[attr-defined]


def warn_of_unmatched(channels: Iterable[LogChannel], patterns: Sequence[str]) -> None:
    """Say which patterns match no channel."""
    known = list(channels)
    for pattern in select(known, patterns)[1]:
        names = ", ".join(sorted({channel_name(channel) for channel in known})) or "none"
        warn(f"no topic is like {pattern!r}; there are: {names}")


def print_conversion(target: Path, done: Conversion) -> int:
    """Say what has become of a log that was imported, and return the exit code."""
    for reason, count in done.left_out.items():
        warn(f"left out {count}: {reason}")
    print(f"{target}: {done.messages} messages")
    return 0
