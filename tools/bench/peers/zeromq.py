"""ZeroMQ over a Unix socket. It sends bytes, so `struct` packs the messages."""

import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tools.bench.peers.peer import Peer, Send
from tools.bench.record import OnMessage
from tools.bench.work import Work

PROBE = struct.Struct("qqdddddd")
HEADER = struct.Struct("qq")


class ZeroMQ(Peer):
    """PUB and SUB. With `lossless`, the queue has no limit; otherwise it has ZeroMQ's default, 1000."""

    title = "ZeroMQ"
    package = "pyzmq"
    module = "zmq"
    how = "PUB/SUB over ipc://, struct; arrays in a separate frame, copy=False; recv blocks"

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Publish through a socket in the work's folder."""
        import zmq  # noqa: PLC0415

        with zmq.Context() as context, context.socket(zmq.PUB) as socket:
            if work.lossless:
                socket.sndhwm = 0
            socket.linger = 0
            socket.bind(_address(work))
            data = _array(work.size_bytes) if work.has_array else None

            def send(number: int) -> None:
                socket.send(PROBE.pack(number, time.monotonic_ns(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0))

            def send_array(number: int) -> None:
                header = HEADER.pack(number, time.monotonic_ns())
                socket.send_multipart((header, data), copy=False)

            yield send_array if work.has_array else send

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Receive until the last message."""
        import zmq  # noqa: PLC0415

        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            if work.lossless:
                socket.rcvhwm = 0
            socket.subscribe(b"")
            socket.connect(_address(work))
            ended = False
            while not ended:
                if work.has_array:
                    header, _data = socket.recv_multipart(copy=False)
                    number, stamp_ns = HEADER.unpack(header.buffer)
                else:
                    number, stamp_ns, *_ = PROBE.unpack(socket.recv())
                ended = handle(number, stamp_ns)


def _address(work: Work) -> str:
    return f"ipc://{work.folder}/zeromq"


def _array(size_bytes: int) -> object:
    import numpy as np  # noqa: PLC0415

    return np.ones(size_bytes, np.uint8)


PEER = ZeroMQ()
