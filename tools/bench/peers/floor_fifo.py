"""The floor with FIFOs: who wakes writes a byte, who waits reads one."""

import contextlib
import os
from collections.abc import Callable
from functools import partial

from tools.bench.peers.floor import Floor, InFolder
from tools.bench.work import Work


class Fifos(InFolder):
    """A pipe for each process that is woken."""

    title = "2 FIFOs"
    how = "os.read and os.write of one byte"

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Read a byte."""
        return partial(os.read, _fifo(work, name), 1)

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Write a byte."""
        return partial(os.write, _fifo(work, name), b"w")


def _fifo(work: Work, name: str) -> int:
    path = work.folder / f"{name}.fifo"
    with contextlib.suppress(FileExistsError):
        os.mkfifo(path, 0o600)
    return os.open(path, os.O_RDWR)  # so that nobody waits for the other end to be opened


PEER = Floor(Fifos())
