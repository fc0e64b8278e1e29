"""Eclipse iceoryx2's request and response: the latency is that of the round trip."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tools.bench.peers.iceoryx2 import Iceoryx2, Probe, open_node
from tools.bench.peers.peer import Handle, Send
from tools.bench.record import Receipts
from tools.bench.work import END, Work


class Iceoryx2Call(Iceoryx2):
    """Client and server share memory. One event service wakes the server, another one the client."""

    title = "iceoryx2: request-response"
    how = "ctypes structures, one copy into each loan; Listener.blocking_wait of an event service each way"
    can_fill_in_place = False
    most_subscribers = 1

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Yield a function that sends a request, waits for the response, and records it."""
        node = open_node(work)
        service, asked, answered = _services(node, work)
        client = service.client_builder().create()
        notifier = asked.notifier_builder().create()
        listener = answered.listener_builder().create()

        yield _sender(Receipts(work, 0).handle, client, notifier, listener)
        del client, notifier, listener, service, asked, answered, node

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Reply until the last request."""
        node = open_node(work)
        service, asked, answered = _services(node, work)
        listener = asked.listener_builder().create()
        notifier = answered.notifier_builder().create()
        # Last: a client that sees the server sends at once, and the listener must not miss that.
        server = service.server_builder().create()
        number = 0
        while number != END:
            listener.blocking_wait()
            while number != END and (request := server.receive()) is not None:
                probe = request.payload().contents
                number = probe.number
                request.loan_uninit().write_payload(probe).send()
                notifier.notify()


def _sender(handle: Handle, client: Any, notifier: Any, listener: Any) -> Send:
    def send(number: int) -> None:
        probe = Probe(number, time.monotonic_ns(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
        pending = client.loan_uninit().write_payload(probe).send()
        if not pending.number_of_server_connections:
            return  # the server is not there yet; the warm-up goes on
        notifier.notify()
        while (response := pending.receive()) is None:
            listener.blocking_wait()
        reply = response.payload().contents
        handle(reply.number, reply.stamp_ns)

    return send


def _services(node: Any, work: Work) -> tuple[Any, Any, Any]:
    """Return the service, and the events that wake the server and the client."""
    import iceoryx2 as iox2  # noqa: PLC0415

    def event(suffix: str) -> Any:
        name = iox2.ServiceName.new(f"{work.topic}/{suffix}")
        return node.service_builder(name).event().max_listeners(1).max_nodes(2).open_or_create()

    name = iox2.ServiceName.new(work.topic)
    service = node.service_builder(name).request_response(Probe, Probe).max_nodes(2).open_or_create()
    return service, event("asked"), event("answered")


PEER = Iceoryx2Call()
