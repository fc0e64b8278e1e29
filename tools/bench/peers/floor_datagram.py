"""The floor with UNIX sockets: to wake a process, another one sends it a datagram of one byte."""

import socket
from collections.abc import Callable
from functools import partial

from tools.bench.peers.floor import Floor, InFolder, until_there
from tools.bench.work import Work


class Datagrams(InFolder):
    """One socket for each process that sleeps."""

    title = "2 UNIX sockets"
    how = "datagrams of one byte"

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that receives a datagram."""
        receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        receiver.bind(_path(work, name))
        return partial(receiver.recv, 1)

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that sends a datagram."""
        sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        until_there(lambda: sender.connect(_path(work, name)))
        return partial(sender.send, b"w")


def _path(work: Work, name: str) -> str:
    return str(work.folder / f"{name}.socket")


PEER = Floor(Datagrams())
