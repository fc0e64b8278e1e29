"""All output of commands, to the terminal or into a file, goes through here.

`robbie` replaces its standard output and standard error by `PlainStream`. So no name or text that a command
prints can control your terminal. Commands themselves set only colours, through `PlainConsole` or
`print_styled`.
"""

import contextlib
import errno
import io
import os
import sys
from collections.abc import Iterable, Iterator
from typing import IO, Any, cast

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.style import Style

from robbie_mp.base.visible_text import one_line, visible

FILE_WIDTH = 160
"""Columns when the output is not a terminal and has no width."""
ERASE_LINE = "\r\x1b[K"
LAST_STANDARD_DESCRIPTOR = 2


class _Layer(io.TextIOBase):
    """A text stream above another one.

    Args:
        below: the stream it writes to; None if the process was started without it.
    """

    def __init__(self, below: IO[str] | None):
        self.below: Any = below

    def flush(self) -> None:
        """Flush the stream below."""
        self.below.flush()

    def close(self) -> None:
        """Leave the stream below open: this stream does not own it."""

    def fileno(self) -> int:
        """Return the file descriptor."""
        if self.below is None:
            raise io.UnsupportedOperation("this stream is closed")
        return int(self.below.fileno())

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return self.below is not None and bool(self.below.isatty())

    def writable(self) -> bool:
        """Return True."""
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of the stream below."""
        return str(getattr(self.below, "encoding", "utf-8"))


class PlainStream(_Layer):
    """A text stream that passes nothing on that a terminal would obey."""

    def write(self, text: str) -> int:
        """Write a text with its control characters made visible."""
        self.below.write(visible(text))
        return len(text)


class WatchedStream(_Layer):
    """A stream that notes when something cannot be written; argparse, for one, does not report it.

    Without a stream below, what is written is lost. That alone ends nothing: a service needs no reader.

    Attributes:
        problem: the first one; None if all was written.
    """

    problem: OSError | None = None

    def write(self, text: str) -> int:
        """Write a text."""
        with self._watched():
            if self.below is None:
                self.problem = OSError(errno.EBADF, "it is closed")
            else:
                self.below.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush the stream below."""
        with self._watched():
            if self.below is not None:
                self.below.flush()

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.problem = self.problem or error
            raise


@contextlib.contextmanager
def plain_output() -> Iterator[None]:
    """Make everything printed on standard output and standard error plain."""
    with contextlib.ExitStack() as replaced:
        for redirect, stream in (
            (contextlib.redirect_stdout, sys.stdout),
            (contextlib.redirect_stderr, sys.stderr),
        ):
            replaced.enter_context(redirect(PlainStream(cast("IO[str]", WatchedStream(stream)))))
        yield


def fill_standard_descriptors() -> None:
    """Open /dev/null in place of standard streams that are closed.

    Otherwise the next file gets such a number, a segment or a log, and what a library or a child of this
    process prints goes into it.
    """
    with contextlib.suppress(OSError):
        while (fd := os.open(os.devnull, os.O_RDWR)) <= LAST_STANDARD_DESCRIPTOR:
            os.set_inheritable(fd, True)
        os.close(fd)


def finish_output() -> bool:
    """Flush standard output; return whether everything was written, and say why not.

    If the reader has ended, as in `robbie profile show demo | head -1`, that is no failure.
    """
    below = _below(sys.stdout)
    if not isinstance(below, WatchedStream):  # of a test
        return True
    with contextlib.suppress(OSError):
        below.flush()
    problem, below.problem = below.problem, None
    if problem is None:
        return True
    with contextlib.suppress(io.UnsupportedOperation):
        os.dup2(os.open(os.devnull, os.O_WRONLY), below.fileno())  # the interpreter flushes again at its end
    if not isinstance(problem, BrokenPipeError):
        say(f"standard output cannot be written: {problem.strerror}")
    return False


def say(text: str) -> None:
    """Print an error on standard error, if that can be written."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


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


def clear_screen() -> None:
    """Clear the terminal, and print from its top."""
    _below(sys.stdout).write("\x1b[H\x1b[J")


def _below(stream: IO[str]) -> IO[str]:
    return stream.below if isinstance(stream, PlainStream) else stream
