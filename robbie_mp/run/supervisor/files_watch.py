"""Notices that somebody has removed or truncated files without which a run cannot continue."""

import os
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

CHECK_PERIOD_S = 0.5

Owner = tuple[str, int]
"""Name and incarnation of the process that alone needs a file."""
Files = Mapping[str, Owner | None]
"""Paths of files with their owners; None: every process needs it."""


class Damage(NamedTuple):
    """What has happened to a file."""

    path: str
    what: str
    owner: Owner | None
    """The only process that has to end; None: no process can start any more."""


class FilesWatch:
    """Looks for files that processes of the run open when they start, or that they have mapped.

    Those that run have mapped their memory. What was removed they keep, but none of them could be restarted;
    what was truncated they have lost.

    Args:
        files: returns the files that must be there now; they are whole before they are returned.
        passing: returns files that may be removed at any time, but not truncated.
        clock: monotonic time in s.
    """

    def __init__(
        self,
        files: Callable[[], Files],
        passing: Callable[[], Files] = dict,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._files = files
        self._passing = passing
        self._clock = clock
        self._largest: dict[str, int] = {}
        """How large each file has ever been, in bytes."""
        self._next_s = clock()
        self.look()

    def look(self) -> list[Damage]:
        """Return what has happened to files, to those that every process needs first.

        Returns nothing if it is not yet time to look again.
        """
        if self._clock() < self._next_s:
            return []
        self._next_s = self._clock() + CHECK_PERIOD_S
        needed = self._files()
        watched = {**self._passing(), **needed}
        sizes = {path: _size(path) for path in watched}
        removed = [Damage(path, "removed", owner) for path, owner in needed.items() if sizes[path] is None]
        largest = {path: max(size or 0, self._largest.get(path, 0)) for path, size in sizes.items()}
        truncated = [
            Damage(path, "truncated", watched[path])
            for path, size in sizes.items()
            if size is not None and (size < largest[path] or (path in needed and not size))
        ]
        self._largest = largest
        return sorted(removed + truncated, key=lambda damage: damage.owner is not None)


def _size(path: str) -> int | None:
    try:
        return os.lstat(path).st_size
    except OSError:
        return None
