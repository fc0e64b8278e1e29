"""Eclipse iceoryx2 over shared memory, whose event service wakes the subscriber."""

import ctypes
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tools.bench.peers.peer import Peer, Send
from tools.bench.record import OnMessage
from tools.bench.work import Work

BUFFER = 64
"""Maximum number of samples that wait for a subscriber."""
FILES = "i"
"""The folder of its sockets: a short name, because the path of a socket has at most 107 bytes."""


class Probe(ctypes.Structure):
    """The small message."""

    _fields_ = (
        ("number", ctypes.c_int64),
        ("stamp_ns", ctypes.c_int64),
        ("x", ctypes.c_double),
        ("y", ctypes.c_double),
        ("z", ctypes.c_double),
        ("roll", ctypes.c_double),
        ("pitch", ctypes.c_double),
        ("yaw", ctypes.c_double),
    )


class Iceoryx2(Peer):
    """Publisher and subscriber share memory, without a process between them."""

    title = "iceoryx2"
    package = "iceoryx2"
    module = "iceoryx2"
    how = "ctypes structures, one copy into the loan; Listener.blocking_wait of an event service"
    can_fill_in_place = True

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Loan a sample, write it, send it, and notify the subscriber."""
        import iceoryx2 as iox2  # noqa: PLC0415

        node = open_node(work)
        service, event = _services(node, work)
        builder = service.publisher_builder().max_loaned_samples(2)
        if work.lossless:
            builder = builder.backpressure_strategy(iox2.BackpressureStrategy.RetryUntilDelivered)
        publisher, notifier = builder.create(), event.notifier_builder().create()
        send = _array_sender if work.has_array else _probe_sender
        yield send(work, publisher, notifier)
        del publisher, notifier, service, event, node

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Wait for events, then take all samples."""
        node = open_node(work)
        service, event = _services(node, work)
        subscriber, listener = service.subscriber_builder().create(), event.listener_builder().create()
        ended = False
        while not ended:
            listener.blocking_wait()
            while not ended and (sample := subscriber.receive()) is not None:
                message = sample.payload().contents
                now_ns = time.monotonic_ns() if work.has_array else 0  # as Robbie's subscriber
                ended = handle(message.number, message.stamp_ns, now_ns)

    def clean(self, work: Work) -> None:
        """Remove this work's segments."""
        for file in Path("/dev/shm").glob(f"{work.topic}*"):
            file.unlink(missing_ok=True)
        shutil.rmtree(work.folder / FILES, ignore_errors=True)


def _message_type(work: Work) -> Any:
    """Return the structure of the work's messages."""
    if not work.has_array:
        return Probe
    fields = (
        ("number", ctypes.c_int64),
        ("stamp_ns", ctypes.c_int64),
        ("data", ctypes.c_uint8 * work.size_bytes),
    )
    return type("Picture", (ctypes.Structure,), {"_fields_": fields})


def _probe_sender(work: Work, publisher: Any, notifier: Any) -> Send:
    def send(number: int) -> None:
        probe = Probe(number, time.monotonic_ns(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
        publisher.loan_uninit().write_payload(probe).send()
        notifier.notify()

    return send


def _array_sender(work: Work, publisher: Any, notifier: Any) -> Send:
    import numpy as np  # noqa: PLC0415

    source = np.ones(work.size_bytes, np.uint8)

    def loan() -> Any:
        return publisher.loan_uninit()

    def fill(message: Any) -> None:
        np.copyto(np.frombuffer(message.data, np.uint8), source)

    def send(number: int) -> None:
        """Copy an existing array."""
        stamp_ns = time.monotonic_ns()
        sample = loan()
        message = sample.payload().contents
        message.number, message.stamp_ns = number, stamp_ns
        fill(message)
        sample.assume_init().send()
        notifier.notify()

    def send_filled(number: int) -> None:
        """Publish an array that was filled in place."""
        sample = loan()
        message = sample.payload().contents
        message.number = number
        fill(message)
        message.stamp_ns = time.monotonic_ns()
        sample.assume_init().send()
        notifier.notify()

    return send_filled if work.in_place else send


def open_node(work: Work) -> Any:
    """Return a node whose files lie in the work's folder."""
    import iceoryx2 as iox2  # noqa: PLC0415

    iox2.set_log_level(iox2.LogLevel.Error)
    config = iox2.config.default()
    config.global_cfg.prefix = iox2.FileName.new(f"{work.topic}_")
    config.global_cfg.root_path = iox2.Path.new(str(work.folder / FILES))
    return iox2.NodeBuilder.new().config(config).create(iox2.ServiceType.Ipc)


def _services(node: Any, work: Work) -> tuple[Any, Any]:
    import iceoryx2 as iox2  # noqa: PLC0415

    name = iox2.ServiceName.new(work.topic)
    service = (
        node.service_builder(name)
        .publish_subscribe(_message_type(work))
        .max_subscribers(work.subscribers)
        .max_nodes(work.subscribers + 1)
        .subscriber_max_buffer_size(BUFFER if not work.has_array else 8)
        .enable_safe_overflow(not work.lossless)
        .open_or_create()
    )
    event = (
        node.service_builder(name)
        .event()
        .max_listeners(work.subscribers)
        .max_nodes(work.subscribers + 1)
        .open_or_create()
    )
    return service, event


PEER = Iceoryx2()
