"""A module's journal of its own events: one line per event, in the page cache before the next step.

Each line ends in ' .', which shows that it is complete. SIGKILL may cut a write short at a page boundary; the
reader ignores such a line. Lines, with times `t` of the monotonic clock in nanoseconds:

    S incarnation t                       a process has started
    I number t                            the module is about to publish this number
    A number t                            `publish` accepted it
    R number t                            `publish` refused it
    E sequence publisher incarnation number whole published t     a handler was entered
    L sequence t                          the handler returned
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path

END = " ."


class Journal:
    """Appends lines to a file, without a buffer in the process.

    Args:
        path: the file, created if it does not exist.
    """

    def __init__(self, path: Path):
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        os.write(self._fd, b"\n")  # the previous process may have died in the middle of a line

    def note(self, *words: object) -> None:
        """Write one line and add the time."""
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
