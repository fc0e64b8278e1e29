"""A way to a link on which datagrams arrive before a stream, and what is declared in them is lost."""

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from robbie_mp.connect.link.wire import ROOT
from tests._support.delaying_proxy import delaying_proxy

STREAM_DELAY_S = 0.2
"""Each way. To open a stream takes four ways, and less time than Zenoh waits for that."""
OTHER = b"x" * len(ROOT)


class GarblingRelay:
    """Relays the datagrams of one program to a port of this machine, and the answers.

    Zenoh joins what it declares with what says that this was all, or does not, as it happens. So the relay
    drops no datagrams of the answers, but changes the keys in them: the rest of them arrives.

    Attributes:
        garbles: whether it does that.
        garbled: datagrams in which it did.
    """

    def __init__(self, port: int, target_port: int):
        self.garbles, self.garbled = True, 0
        self._near, self._far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._near.bind(("127.0.0.1", port))
        self._far.connect(("127.0.0.1", target_port))
        self._ends = False
        self._thread = threading.Thread(target=self._relay)
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._ends = True
        self._thread.join()
        self._near.close()
        self._far.close()

    def _relay(self) -> None:
        sender: tuple[str, int] | None = None
        while not self._ends:
            for one in select.select([self._near, self._far], [], [], 0.05)[0]:
                data, address = one.recvfrom(1 << 16)
                if one is self._near:
                    sender = address
                    self._far.send(data)
                    continue
                if self.garbles and ROOT.encode() in data:
                    self.garbled += 1
                    data = data.replace(ROOT.encode(), OTHER)
                if sender is not None:
                    self._near.sendto(data, sender)


@contextmanager
def garbling_relay(target_port: int) -> Iterator[tuple[int, GarblingRelay]]:
    """Run a relay; yields the port for streams and datagrams, and it."""
    with delaying_proxy(target_port, STREAM_DELAY_S) as streams:
        relay = GarblingRelay(streams.port, target_port)
        try:
            yield streams.port, relay
        finally:
            relay.close()
