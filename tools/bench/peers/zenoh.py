"""Eclipse Zenoh, peer to peer, with arrays in its shared memory."""

import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tools.bench.peers.peer import Peer, Send
from tools.bench.processes import remove_unmapped
from tools.bench.record import OnMessage
from tools.bench.work import Work

PROBE = struct.Struct("qqdddddd")
HEADER = struct.Struct("qq")
SHARED_MESSAGES = 8


class Zenoh(Peer):
    """The publisher listens on a Unix socket and subscribers connect to it, so discovery is not needed."""

    title = "Zenoh"
    package = "eclipse-zenoh"
    module = "zenoh"
    how = "unixsock-stream, express, struct; arrays through its shared memory; callback"
    can_fill_in_place = True

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Put messages."""
        import zenoh  # noqa: PLC0415

        control = zenoh.CongestionControl
        congestion = control.BLOCK if work.lossless or work.has_array else control.DROP
        with zenoh.open(configuration(work, "listen")) as session:
            publisher = session.declare_publisher(work.topic, congestion_control=congestion, express=True)

            def send(number: int) -> None:
                publisher.put(PROBE.pack(number, time.monotonic_ns(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0))

            yield _array_sender(work, publisher) if work.has_array else send

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Wait in the main thread while Zenoh's thread runs the callback."""
        import zenoh  # noqa: PLC0415

        ended = threading.Event()

        def on_probe(sample: Any) -> None:
            number, stamp_ns, *_ = PROBE.unpack(sample.payload.to_bytes())
            if handle(number, stamp_ns):
                ended.set()

        def on_array(sample: Any) -> None:
            sample.payload.to_bytes()  # Zenoh's Python API has no view of data in shared memory
            if handle(*HEADER.unpack(sample.attachment.to_bytes())):
                ended.set()

        with zenoh.open(configuration(work, "connect")) as session:
            session.declare_subscriber(work.topic, on_array if work.has_array else on_probe)
            ended.wait()

    def clean(self, work: Work) -> None:
        """Remove segments that no process uses, as Zenoh does whenever one of its processes starts."""
        remove_unmapped(Path("/dev/shm").glob("*.zenoh"))


def _array_sender(work: Work, publisher: Any) -> Send:
    import zenoh  # noqa: PLC0415

    data = b"1" * work.size_bytes
    provider = zenoh.shm.ShmProvider.default_backend(SHARED_MESSAGES * work.size_bytes)
    policy = zenoh.shm.BlockOn(zenoh.shm.GarbageCollect())

    def send(number: int) -> None:
        stamp_ns = time.monotonic_ns()
        buffer = provider.alloc(work.size_bytes, policy=policy)
        buffer[:] = data
        publisher.put(buffer, attachment=HEADER.pack(number, stamp_ns))

    def send_filled(number: int) -> None:
        buffer = provider.alloc(work.size_bytes, policy=policy)
        buffer[:] = data
        publisher.put(buffer, attachment=HEADER.pack(number, time.monotonic_ns()))

    return send_filled if work.in_place else send


def configuration(work: Work, role: str) -> Any:
    """Return the configuration of a session: `role` is listen or connect."""
    import zenoh  # noqa: PLC0415

    zenoh.init_log_from_env_or("error")
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"peer"')
    configuration.insert_json5("scouting/multicast/enabled", "false")
    configuration.insert_json5("listen/endpoints", "[]")
    configuration.insert_json5(f"{role}/endpoints", f'["unixsock-stream/{work.folder}/zenoh"]')
    return configuration


PEER = Zenoh()
