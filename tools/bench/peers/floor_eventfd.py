"""The floor with eventfds: the process that sleeps makes one and sends it to the other through a socket."""

import os
import socket
import threading
from collections.abc import Callable
from functools import partial

from tools.bench.peers.floor import Floor, InFolder, until_there
from tools.bench.work import Work


class Eventfds(InFolder):
    """One eventfd for each process that sleeps. It works as a semaphore, so that each wake-up counts."""

    title = "2 eventfds"
    how = "os.eventfd_read and os.eventfd_write"

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that decrements the counter."""
        eventfd = os.eventfd(0, os.EFD_SEMAPHORE)
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(_path(work, name))
        listener.listen()

        def hand_over() -> None:
            connection, _ = listener.accept()
            socket.send_fds(connection, [b"e"], [eventfd])

        threading.Thread(target=hand_over, daemon=True).start()
        return partial(os.eventfd_read, eventfd)

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that increments the counter."""
        with socket.socket(socket.AF_UNIX) as connection:
            until_there(lambda: connection.connect(_path(work, name)))
            _, (eventfd,), _, _ = socket.recv_fds(connection, 1, 1)
        return partial(os.eventfd_write, eventfd, 1)


def _path(work: Work, name: str) -> str:
    return str(work.folder / f"{name}.socket")


PEER = Floor(Eventfds())
