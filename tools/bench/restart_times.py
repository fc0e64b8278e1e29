"""Records the times of one start of the restart benchmark's subject."""

import json
import os
import time
from pathlib import Path


class StartTimes:
    """The times of one start on the monotonic clock, in ns. Each process writes them to a separate file.

    Args:
        folder: folder of that file.
        import_begin_ns: begin of the import of the subject's class.
        import_end_ns: end of that import.
    """

    def __init__(self, folder: Path, import_begin_ns: int, import_end_ns: int):
        self._folder = folder
        self._times_ns = {"import_begin": import_begin_ns, "import_end": import_end_ns}
        self._is_first = True

    def setup_ends(self) -> None:
        """Record the end of `setup`."""
        self._times_ns["setup_end"] = time.monotonic_ns()

    def message_comes(self) -> None:
        """At the first message, write all times to the file."""
        first_ns = time.monotonic_ns()
        if not self._is_first:
            return
        self._is_first = False
        unfinished = self._folder / f"{os.getpid()}.unfinished"
        unfinished.write_text(json.dumps({**self._times_ns, "first_message": first_ns}))
        unfinished.rename(self._folder / f"{os.getpid()}.json")
