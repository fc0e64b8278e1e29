"""The floor with FIFOs: to wake a process, another one writes a byte, which the process reads."""

import contextlib
import os
from collections.abc import Callable
from functools import partial

from tools.bench.peers.floor import Floor, InFolder
from tools.bench.work import Work


class Fifos(InFolder):
    """One pipe for each process that sleeps."""

    title = "2 FIFOs"
    how = "os.read and os.write of one byte"

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that reads a byte."""
        return partial(os.read, _fifo(work, name), 1)

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that writes a byte."""
        return partial(os.write, _fifo(work, name), b"w")


def _fifo(work: Work, name: str) -> int:
    path = work.folder / f"{name}.fifo"
    with contextlib.suppress(FileExistsError):
        os.mkfifo(path, 0o600)
    return os.open(path, os.O_RDWR)  # O_RDWR: do not wait until the other end is opened


PEER = Floor(Fifos())
