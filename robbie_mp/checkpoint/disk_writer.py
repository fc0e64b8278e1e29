"""The thread that brings a module's newest checkpoint to disk, so that the module need not wait for it."""

import logging
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from robbie_mp.checkpoint.file import write_file
from robbie_mp.checkpoint.image import check_crc, read_header
from robbie_mp.errors import RobbieError


class DiskWriter:
    """Writes the newest checkpoint to a file, at most once in a period, and once more at the end.

    Args:
        path: the file.
        every_s: the period.
        newest: holds the image of the newest checkpoint while it is being written.
        log: hears of what the disk refuses.
    """

    def __init__(
        self,
        path: Path,
        every_s: float,
        newest: Callable[[], AbstractContextManager[memoryview]],
        log: logging.Logger,
    ):
        self._path = path
        self._every_s = every_s
        self._newest = newest
        self._log = log
        self._change = threading.Condition()
        self._is_wanted = False
        self._is_closing = False
        self._thread = threading.Thread(target=self._run, name=f"write {path.name}", daemon=True)
        self._thread.start()

    def write_soon(self) -> None:
        """Have the newest checkpoint written when its time has come; returns at once."""
        with self._change:
            self._is_wanted = True
            self._change.notify()

    def close(self) -> None:
        """Write what is not on disk yet, and end the thread."""
        with self._change:
            self._is_closing = True
            self._change.notify()
        self._thread.join()

    def _run(self) -> None:
        not_before_s = time.monotonic()
        while self._waits_for_work(not_before_s):
            not_before_s = time.monotonic() + self._every_s
            try:
                with self._newest() as image:
                    # A good file is not to be replaced by an image that has been damaged since.
                    check_crc(image, read_header(image, len(image)))
                    write_file(self._path, image)
            except (OSError, RobbieError) as error:
                self._log.warning("the checkpoint is not on disk: %s", error)

    def _waits_for_work(self, not_before_s: float) -> bool:
        """Wait until something is to be written and may be; False at the end of it all."""
        with self._change:
            self._change.wait_for(lambda: self._is_wanted or self._is_closing)
            self._change.wait_for(lambda: self._is_closing, not_before_s - time.monotonic())
            is_wanted, self._is_wanted = self._is_wanted, False
            return is_wanted
