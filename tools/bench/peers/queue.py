"""Python's multiprocessing.Queue: one queue for each subscriber, with pickled dataclasses."""

import multiprocessing
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any

from tools.bench.peers.peer import Handle, Peer, Send, worker_command
from tools.bench.publishing import DRAIN_LIMIT_S
from tools.bench.work import Work


@dataclass
class Probe:
    """The small message."""

    number: int
    stamp_ns: int
    x: float = 1.0
    y: float = 2.0
    z: float = 3.0
    roll: float = 4.0
    pitch: float = 5.0
    yaw: float = 6.0


@dataclass
class Picture:
    """The large message."""

    number: int
    stamp_ns: int
    data: Any


class MultiprocessingQueue(Peer):
    """The processes inherit their queues, so one of them must be the parent of the others: the relay."""

    title = "multiprocessing.Queue"
    how = "pickled dataclass; Queue.get blocks"

    def __init__(self, queues: "list[Queue[Any]] | None" = None):
        self._queues = queues or []

    def commands(self, name: str, work: Work, work_file: Path) -> list[list[str]]:
        """Return the command line of the parent."""
        return [worker_command(name, "relay", work_file)]

    def relay(self, work: Work) -> None:
        """Start publisher and subscribers, and wait for them."""
        from tools.bench.worker import run  # noqa: PLC0415 (it imports this package)

        context = multiprocessing.get_context("spawn")
        peer = MultiprocessingQueue([context.Queue() for _ in range(work.subscribers)])
        roles = [*(f"subscriber-{index}" for index in range(work.subscribers)), "publisher"]
        processes = [context.Process(target=run, args=(peer, role, work), daemon=True) for role in roles]
        for process in processes:
            process.start()
        processes[-1].join()
        for process in processes[:-1]:
            process.join(DRAIN_LIMIT_S)
            process.terminate()  # it lacks the last message, and the publisher no longer waits for it
        if processes[-1].exitcode:
            raise SystemExit(1)

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Put messages into every queue."""
        queues = self._queues
        data = _array(work.size_bytes) if work.has_array else None

        def send(number: int) -> None:
            if data is None:
                message: Any = Probe(number, time.monotonic_ns())
            else:
                message = Picture(number, time.monotonic_ns(), data)
            for queue in queues:
                queue.put(message)

        yield send
        for queue in queues:
            queue.cancel_join_thread()  # no process reads the queue any more

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Get messages from the queue of this subscriber."""
        queue = self._queues[index]
        ended = False
        while not ended:
            message = queue.get()
            ended = handle(message.number, message.stamp_ns)


def _array(size_bytes: int) -> Any:
    import numpy as np  # noqa: PLC0415 (only large messages need it)

    return np.ones(size_bytes, np.uint8)


PEER = MultiprocessingQueue()
