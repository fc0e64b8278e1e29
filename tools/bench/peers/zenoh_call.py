"""Eclipse Zenoh's query and reply: the latency is that of the round trip."""

import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tools.bench.peers.peer import Handle, Send
from tools.bench.peers.zenoh import Zenoh, configuration
from tools.bench.record import Receipts
from tools.bench.work import END, Work

PROBE = struct.Struct("qqdddddd")


class ZenohCall(Zenoh):
    """The client, which the bench calls publisher, waits until the reply is there."""

    title = "Zenoh: query"
    how = "get and queryable, unixsock-stream, express, struct; callback in the server"
    can_fill_in_place = False
    most_subscribers = 1

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Yield a function that sends a query, waits for the reply, and records it."""
        import zenoh  # noqa: PLC0415

        handle = Receipts(work, 0).handle
        with zenoh.open(configuration(work, "listen")) as session:

            def send(number: int) -> None:
                payload = PROBE.pack(number, time.monotonic_ns(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
                for reply in session.get(work.topic, payload=payload, express=True):
                    answered, stamp_ns, *_ = PROBE.unpack(reply.ok.payload.to_bytes())
                    handle(answered, stamp_ns)

            yield send

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Wait in the main thread while Zenoh's thread replies."""
        import zenoh  # noqa: PLC0415

        ended = threading.Event()

        def on_query(query: Any) -> None:
            data = query.payload.to_bytes()
            query.reply(work.topic, data, express=True)
            if PROBE.unpack(data)[0] == END:
                ended.set()

        with zenoh.open(configuration(work, "connect")) as session:
            session.declare_queryable(work.topic, on_query)
            ended.wait()


PEER = ZenohCall()
