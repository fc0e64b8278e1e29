"""Writes down when a start of the restart benchmark's subject came how far."""

import json
import os
import time
from pathlib import Path


class StartTimes:
    """The times of one start, monotonic clock in ns; they go to a file of the process's own.

    Args:
        folder: where that file is.
        import_begin_ns: when the import of the subject's class began.
        import_end_ns: when it was over.
    """

    def __init__(self, folder: Path, import_begin_ns: int, import_end_ns: int):
        self._folder = folder
        self._times_ns = {"import_begin": import_begin_ns, "import_end": import_end_ns}
        self._is_first = True

    def setup_ends(self) -> None:
        """Note that setup is over."""
        self._times_ns["setup_end"] = time.monotonic_ns()

    def message_comes(self) -> None:
        """Write all times at the first message."""
        first_ns = time.monotonic_ns()
        if not self._is_first:
            return
        self._is_first = False
        unfinished = self._folder / f"{os.getpid()}.unfinished"
        unfinished.write_text(json.dumps({**self._times_ns, "first_message": first_ns}))
        unfinished.rename(self._folder / f"{os.getpid()}.json")
