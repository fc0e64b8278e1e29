"""ZeroMQ's request and reply over a Unix socket: the latency is that of the round trip."""

import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tools.bench.peers.peer import Handle, Peer, Send
from tools.bench.record import Receipts
from tools.bench.work import END, Work

PROBE = struct.Struct("qqdddddd")


class ZeroMQCall(Peer):
    """REQ and REP. The client, which the bench calls publisher, blocks until the reply is there."""

    title = "ZeroMQ: REQ/REP"
    package = "pyzmq"
    module = "zmq"
    how = "REQ/REP over ipc://, struct; recv blocks"
    most_subscribers = 1

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Yield a function that sends a request, waits for the reply, and records it."""
        import zmq  # noqa: PLC0415

        handle = Receipts(work, 0).handle
        with zmq.Context() as context, context.socket(zmq.REQ) as socket:
            socket.linger = 0
            socket.connect(_address(work))

            def send(number: int) -> None:
                socket.send(PROBE.pack(number, time.monotonic_ns(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
                answered, stamp_ns, *_ = PROBE.unpack(socket.recv())
                handle(answered, stamp_ns)

            yield send

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Reply until the last request."""
        import zmq  # noqa: PLC0415

        with zmq.Context() as context, context.socket(zmq.REP) as socket:
            socket.bind(_address(work))
            number = 0
            while number != END:
                number, stamp_ns, *rest = PROBE.unpack(socket.recv())
                socket.send(PROBE.pack(number, stamp_ns, *rest))


def _address(work: Work) -> str:
    return f"ipc://{work.folder}/zeromq"


PEER = ZeroMQCall()
