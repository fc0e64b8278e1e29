"""The floor with UNIX sockets: who wakes sends a datagram of one byte."""

import socket
from collections.abc import Callable
from functools import partial

from tools.bench.peers.floor import Floor, InFolder, until_there
from tools.bench.work import Work


class Datagrams(InFolder):
    """A socket for each process that is woken."""

    title = "2 UNIX sockets"
    how = "datagrams of one byte"

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Receive a datagram."""
        receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        receiver.bind(_path(work, name))
        return partial(receiver.recv, 1)

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Send a datagram."""
        sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        until_there(lambda: sender.connect(_path(work, name)))
        return partial(sender.send, b"w")


def _path(work: Work, name: str) -> str:
    return str(work.folder / f"{name}.socket")


PEER = Floor(Datagrams())
