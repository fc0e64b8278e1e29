"""What a module writes down about itself: one line an event, in the page cache before the next step.

A line ends in ' .', so that one cut short by SIGKILL (which may end a write at a page's border) can be told;
it counts as never written. Lines, with times `t` of the monotonic clock in nanoseconds:

    S incarnation t                       a process has begun
    I number t                            it is going to publish this number
    A number t                            it was accepted
    R number t                            it was refused
    E sequence publisher incarnation number whole published t     a handler was entered
    L sequence t                          and left
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path

END = " ."


class Journal:
    """Appends lines to a file, without a buffer of the process's own.

    Args:
        path: the file; it is made if it is not there.
    """

    def __init__(self, path: Path):
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        os.write(self._fd, b"\n")  # the process before may have died in the middle of a line

    def note(self, *words: object) -> None:
        """Write one line; the time is added."""
        os.write(self._fd, f"{' '.join(map(str, words))} {time.monotonic_ns()}{END}\n".encode())


def read_journal(path: Path) -> Iterator[list[str]]:
    """Yield the words of each whole line, without its end."""
    if not path.exists():
        return
    with path.open() as lines:
        for line in lines:
            words = line.split()
            if words and words[-1] == ".":
                yield words[:-1]
