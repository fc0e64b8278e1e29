"""The one way of all that commands print, on the terminal or into a file.

`robbie` has its standard output and standard error replaced by `PlainStream`: whatever a command prints, a
name of others cannot make the terminal do anything. What commands themselves tell the terminal, which is
colours, goes through `PlainConsole` or `print_styled`.
"""

import contextlib
import io
import sys
from collections.abc import Iterable, Iterator
from typing import IO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.style import Style

from robbie_mp.visible_text import one_line, visible

FILE_WIDTH = 160
"""Columns where nobody tells how wide the paper is."""
ERASE_LINE = "\r\x1b[K"


class PlainStream(io.TextIOBase):
    """A text stream that lets nothing pass that a terminal would obey.

    Args:
        below: where it writes.
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
        """Leave the stream below open: it is somebody else's."""

    def fileno(self) -> int:
        """Return the descriptor."""
        return self.below.fileno()

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self.below.isatty()

    def writable(self) -> bool:
        """It is."""
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """As characters are written."""
        return str(getattr(self.below, "encoding", "utf-8"))


@contextlib.contextmanager
def plain_output() -> Iterator[None]:
    """Make all that is printed on standard output and standard error plain."""
    with contextlib.ExitStack() as replaced:
        if sys.stdout is not None:  # as for a service that was started with closed descriptors
            replaced.enter_context(contextlib.redirect_stdout(PlainStream(sys.stdout)))
        if sys.stderr is not None:
            replaced.enter_context(contextlib.redirect_stderr(PlainStream(sys.stderr)))
        yield


class PlainConsole(Console):
    """Prints tables and styled text; only the styles are the terminal's to obey, and no text is markup.

    Args:
        file: where it prints.
        width: columns; None: as many as the terminal has.
    """

    def __init__(self, file: IO[str], width: int | None = None):
        below = file.below if isinstance(file, PlainStream) else file
        super().__init__(file=below, width=width, highlight=False, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of something, their text made visible."""
        for segment in super().render(renderable, options):
            is_plain = segment.control or segment.text.isprintable()
            yield segment if is_plain else Segment(visible(segment.text), segment.style)


def console() -> PlainConsole:
    """Return where tables are printed: as wide as the terminal, or wide enough for a file."""
    return PlainConsole(sys.stdout, None if sys.stdout.isatty() else FILE_WIDTH)


def warn(text: str) -> None:
    """Say on standard error, in one line, what is not as it should be."""
    print(f"warning: {one_line(text)}", file=sys.stderr)


def print_styled(head: str, text: str, style: Style) -> None:
    """Print a line whose end is in a style; much faster than a console."""
    _below(sys.stdout).write(f"{visible(head)}{style.render(visible(text))}\n")


def print_in_place(text: str) -> None:
    """Print a line in the place of the terminal's last one."""
    below = _below(sys.stdout)
    below.write(ERASE_LINE + one_line(text))
    below.flush()


def _below(stream: IO[str]) -> IO[str]:
    return stream.below if isinstance(stream, PlainStream) else stream
