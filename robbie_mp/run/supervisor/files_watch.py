"""Notices that somebody has removed files without which a run cannot continue."""

import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path

CHECK_PERIOD_S = 0.5


class FilesWatch:
    """Looks for files that processes of the run open when they start.

    Those that run have mapped their memory and continue; but none of them could be restarted.

    Args:
        files: returns the files that must be there now.
        clock: monotonic time in s.
    """

    def __init__(self, files: Callable[[], Iterable[Path]], clock: Callable[[], float] = time.monotonic):
        self._files = files
        self._clock = clock
        self._next_s = clock()

    def missing(self) -> str:
        """Return the first file that is missing, '' if none is or if it is not yet time to look again."""
        if self._clock() < self._next_s:
            return ""
        self._next_s = self._clock() + CHECK_PERIOD_S
        return next((str(file) for file in self._files() if not os.path.lexists(file)), "")
