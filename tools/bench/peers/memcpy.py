"""The lower bound for one copy: from one array of a process into another."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from tools.bench.peers.peer import Peer, Send
from tools.bench.record import OnMessage
from tools.bench.work import END, Work


class Memcpy(Peer):
    """Copies at the rate at which the others publish, so that caches are equally cold."""

    title = "floor: memcpy"
    how = "numpy.copyto between two arrays of one process"

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Publish nothing: the receiver copies."""
        yield lambda _number: None

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Copy at the work's rate."""
        source = np.ones(work.size_bytes, np.uint8)
        target = np.zeros(work.size_bytes, np.uint8)
        for number in (*[-1] * work.warm_up, *range(work.count)):
            time.sleep(1 / work.rate_hz)
            stamp_ns = time.monotonic_ns()
            np.copyto(target, source)
            handle(number, stamp_ns)
        handle(END, 0)


PEER = Memcpy()
