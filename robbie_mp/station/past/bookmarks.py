"""The bookmarks of operators in a log, kept in a file beside it."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import NamedTuple

from robbie_mp.base.linux.private_files import write_private

SUFFIX = ".bookmarks.json"
MAX_BOOKMARKS, MAX_TEXT, MAX_FILE_BYTES = 200, 80, 100_000


class Bookmark(NamedTuple):
    """A moment of a log."""

    time_ns: int
    text: str


class Bookmarks:
    """The bookmarks of the log that plays. Any thread may call it.

    Attributes:
        all: by time. The tuple is replaced and never changed, because pages read it.
        error: why they are not kept, or could not be read; '' if they are.
    """

    def __init__(self) -> None:
        self.all: tuple[Bookmark, ...] = ()
        self.error = ""
        self._log: str | None = None
        self._path: Path | None = None
        self._may_write = True
        """Not if the file could not be read: what is in it must not be lost."""
        self._lock = threading.Lock()

    def open(self, log: str) -> None:
        """Read those of a log, unless it is the last one read."""
        with self._lock:
            if log == self._log:
                return
            self._log, self._path, self.all, self.error, self._may_write = log, None, (), "", True
            try:
                self._path = file_of(Path(log))
                self.all = _read(self._path)
            except (OSError, ValueError, TypeError, KeyError) as error:
                name = self._path.name if self._path else "the file of bookmarks"
                self.error = f"{name} cannot be read, and stays as it is; new ones are not kept: {error}"
                self._may_write = False

    def add(self, time_ns: int) -> Bookmark | None:
        """Add one; return it, or None if there are too many."""
        with self._lock:
            if len(self.all) >= MAX_BOOKMARKS:
                return None
            texts = {one.text for one in self.all}
            text = next(
                name for number in range(1, MAX_BOOKMARKS + 2) if (name := f"bookmark {number}") not in texts
            )
            new = Bookmark(time_ns, text)
            self._keep((*self.all, new))
            return new

    def rename(self, bookmark: Bookmark, text: str) -> None:
        """Give one another text."""
        text = text.strip()[:MAX_TEXT]
        with self._lock:
            if text and bookmark in self.all:
                self._keep(tuple(one._replace(text=text) if one == bookmark else one for one in self.all))

    def remove(self, bookmark: Bookmark) -> None:
        """Remove one."""
        with self._lock:
            self._keep(tuple(one for one in self.all if one != bookmark))

    def _keep(self, bookmarks: tuple[Bookmark, ...]) -> None:
        self.all = tuple(sorted(bookmarks))
        if self._path is None or not self._may_write:
            return
        try:
            write_private(self._path, json.dumps([one._asdict() for one in self.all], indent=1))
            self.error = ""
        except OSError as error:
            self.error = f"they end with this page's station: {error}"


def file_of(log: Path) -> Path:
    """Return the file with the bookmarks of a log; of a folder with parts it is inside."""
    return log / f"log{SUFFIX}" if log.is_dir() else log.with_name(log.name + SUFFIX)


def _read(path: Path) -> tuple[Bookmark, ...]:
    """Read a file of bookmarks.

    Raises:
        OSError: it cannot be read.
        ValueError, TypeError, KeyError: it is damaged.
    """
    if not path.exists():
        return ()
    if path.stat().st_size > MAX_FILE_BYTES:
        raise ValueError("it is too large")
    found = json.loads(path.read_text())
    made = [Bookmark(int(one["time_ns"]), str(one["text"])[:MAX_TEXT]) for one in found[:MAX_BOOKMARKS]]
    return tuple(sorted(made))
