"""All output of commands, to the terminal or into a file, goes through here.

`robbie` replaces its standard output and standard error by `PlainStream`. So no name or text that a command
prints can control your terminal. Commands themselves set only colours, through `PlainConsole` or
`print_styled`.
"""

import contextlib
import io
import sys
from collections.abc import Iterable, Iterator
from typing import IO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.style import Style

from robbie_mp.base.visible_text import one_line, visible

FILE_WIDTH = 160
"""Columns when the output is not a terminal and has no width."""
ERASE_LINE = "\r\x1b[K"


class PlainStream(io.TextIOBase):
    """A text stream that passes nothing on that a terminal would obey.

    Args:
        below: the stream it writes to.
    """

    def __init__(self, below: IO[str]):
        self.below = below

    def write(self, text: str) -> int:
        """Write a text with its control characters made visible."""
        self.below.write(visible(text))
        return len(text)

    def flush(self) -> None:
        """Flush the stream below."""
        self.below.flush()

    def close(self) -> None:
        """Leave the stream below open: this stream does not own it."""

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self.below.fileno()

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return self.below.isatty()

    def writable(self) -> bool:
        """Return True."""
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of the stream below."""
        return str(getattr(self.below, "encoding", "utf-8"))


@contextlib.contextmanager
def plain_output() -> Iterator[None]:
    """Make everything printed on standard output and standard error plain."""
    with contextlib.ExitStack() as replaced:
        if sys.stdout is not None:  # None if a service was started with closed descriptors
            replaced.enter_context(contextlib.redirect_stdout(PlainStream(sys.stdout)))
        if sys.stderr is not None:
            replaced.enter_context(contextlib.redirect_stderr(PlainStream(sys.stderr)))
        yield


class PlainConsole(Console):
    """Prints tables and styled text. Only styles reach the terminal as escapes; no text is read as markup.

    Args:
        file: the stream it prints to.
        width: columns; None: the terminal's width.
    """

    def __init__(self, file: IO[str], width: int | None = None):
        below = file.below if isinstance(file, PlainStream) else file
        super().__init__(file=below, width=width, highlight=False, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of a renderable, with their text made visible."""
        for segment in super().render(renderable, options):
            is_plain = segment.control or segment.text.isprintable()
            yield segment if is_plain else Segment(visible(segment.text), segment.style)


def console() -> PlainConsole:
    """Return the console for tables: as wide as the terminal, or wide enough for a file."""
    return PlainConsole(sys.stdout, None if sys.stdout.isatty() else FILE_WIDTH)


def warn(text: str) -> None:
    """Print a one-line warning on standard error."""
    print(f"warning: {one_line(text)}", file=sys.stderr)


def print_styled(head: str, text: str, style: Style) -> None:
    """Print a line whose end has a style; much faster than a console."""
    _below(sys.stdout).write(f"{visible(head)}{style.render(visible(text))}\n")


def print_in_place(text: str) -> None:
    """Print a line over the terminal's last one."""
    below = _below(sys.stdout)
    below.write(ERASE_LINE + one_line(text))
    below.flush()


def _below(stream: IO[str]) -> IO[str]:
    return stream.below if isinstance(stream, PlainStream) else stream
