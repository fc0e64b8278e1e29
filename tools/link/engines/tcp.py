"""TCP as a user of Linux may tune it: a connection for each class, in which little waits."""

import contextlib
import select
import socket
import struct
import threading
import time

from tools.link.engines.side import KEPT, OnMessage

PORT = 7460
UNSENT_BYTES = 4096
"""A connection takes no more while it has this much that it has not sent yet."""
TCP_RTO_MAX_MS = 44
RTO_MAX_MS = 1000
"""Most time between two repetitions, from Linux 6.15 on; before, the kernel doubles it up to two minutes."""
SIZE = struct.Struct("<I")


class TunedTcp:
    """An `Engine`. Connections outlive breaks of the network."""

    def __init__(self, own: str, other: str, sends: list[str], on_message: OnMessage):
        self._on_message = on_message
        self._connections: dict[str, socket.socket] = {}
        listens = "bulk" in sends
        ports = {topic: PORT + number for number, topic in enumerate(KEPT)}
        servers = {topic: socket.create_server((own, port)) for topic, port in ports.items() if listens}
        for topic, port in ports.items():
            connection = servers[topic].accept()[0] if listens else _connected(other, port)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
            with contextlib.suppress(OSError):
                connection.setsockopt(socket.IPPROTO_TCP, TCP_RTO_MAX_MS, RTO_MAX_MS)
            self._connections[topic] = connection
            threading.Thread(target=self._receive, args=(topic, connection), daemon=True).start()

    def wait_for_room(self, topic: str) -> None:
        """Wait until what was sent before has left."""
        waiting = select.poll()
        waiting.register(self._connections[topic], select.POLLOUT)
        waiting.poll()

    def send(self, topic: str, data: bytes) -> None:
        """Send a message."""
        self._connections[topic].sendall(SIZE.pack(len(data)) + data)

    def _receive(self, topic: str, connection: socket.socket) -> None:
        with connection.makefile("rb") as stream:
            while head := stream.read(SIZE.size):
                self._on_message(topic, stream.read(*SIZE.unpack(head)))


def _connected(other: str, port: int) -> socket.socket:
    """Return a connection to a server that may not have started."""
    while True:
        with contextlib.suppress(OSError):
            return socket.create_connection((other, port))
        time.sleep(0.05)


ENGINE = TunedTcp
