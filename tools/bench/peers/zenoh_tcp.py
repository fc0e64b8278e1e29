"""Plain Zenoh over TCP, as links use it: the publisher listens, and all bytes go through the socket."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tools.bench.peers.peer import Handle, Send
from tools.bench.peers.zenoh import HEADER, PROBE, Zenoh
from tools.bench.work import Work

PORT_FILE = "port"


class ZenohTcp(Zenoh):
    """Two processes with a session each, and nothing of Robbie-MP."""

    title = "Zenoh over TCP"
    how = "tcp, express, struct; arrays as bytes; callback"
    can_fill_in_place = False
    most_subscribers = 1

    def commands(self, name: str, work: Work, work_file: Any) -> list[list[str]]:
        """Choose a free port for the processes, and return their command lines."""
        (work.folder / PORT_FILE).write_text(str(free_port()))
        return super().commands(name, work, work_file)

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Put messages."""
        import zenoh  # noqa: PLC0415

        with zenoh.open(tcp_configuration(work, "listen")) as session:
            yield sender(session, work)

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Wait in the main thread while Zenoh's thread runs the callback."""
        import zenoh  # noqa: PLC0415

        ended = threading.Event()
        with zenoh.open(tcp_configuration(work, "connect")) as session:
            session.declare_subscriber(work.topic, self.receiver(work, handle, ended))
            ended.wait()

    def receiver(self, work: Work, handle: Handle, ended: threading.Event) -> Callable[[Any], None]:
        """Return a function that takes a sample, and tells when it was the last one."""

        def on_sample(sample: Any) -> None:
            data = sample.payload.to_bytes()
            header = HEADER.unpack(sample.attachment.to_bytes()) if work.has_array else PROBE.unpack(data)
            if handle(*header[:2]):
                ended.set()

        return on_sample


def sender(session: Any, work: Work) -> Send:
    """Return a function that puts messages, and waits where there is no room."""
    import zenoh  # noqa: PLC0415

    data = b"1" * work.size_bytes
    publisher = session.declare_publisher(
        work.topic, congestion_control=zenoh.CongestionControl.BLOCK, express=True
    )

    def send(number: int) -> None:
        publisher.put(PROBE.pack(number, time.monotonic_ns(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0))

    def send_array(number: int) -> None:
        publisher.put(data, attachment=HEADER.pack(number, time.monotonic_ns()))

    return send_array if work.has_array else send


def tcp_configuration(work: Work, role: str) -> Any:
    """Return the configuration of a session: `role` is listen or connect."""
    import zenoh  # noqa: PLC0415

    zenoh.init_log_from_env_or("error")
    found = zenoh.Config()
    found.insert_json5("mode", '"peer"')
    found.insert_json5("scouting/multicast/enabled", "false")
    found.insert_json5("transport/shared_memory/enabled", "false")
    found.insert_json5("listen/endpoints", "[]")
    port = (work.folder / PORT_FILE).read_text()
    found.insert_json5(f"{role}/endpoints", f'["tcp/127.0.0.1:{port}"]')
    return found


def free_port() -> int:
    """Return a port that no process listens on."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        port: int = listening.getsockname()[1]
        return port


PEER = ZenohTcp()
