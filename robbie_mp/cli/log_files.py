"""How commands take logs and topics, and how they show that they work on one."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from robbie_mp.cli import completers

if TYPE_CHECKING:
    from robbie_mp.recording.repair import Progress


def add_log_argument(parser: argparse.ArgumentParser, name: str = "log", nargs: str | None = None) -> None:
    """Add an argument that names a log."""
    text = "a log: an MCAP file, or a folder of parts"
    argument = parser.add_argument(name, metavar=name.upper(), type=Path, nargs=nargs, help=text)
    argument.completer = completers.logs  # type: ignore[attr-defined]


@contextmanager
def progress_bar(text: str) -> "Iterator[Progress]":
    """Show on a terminal how far something is; what is yielded is told so.

    Args:
        text: what is done.
    """
    if not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import Progress as Bar  # noqa: PLC0415

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text)
        yield lambda done, total: bar.update(task, completed=done, total=total)
