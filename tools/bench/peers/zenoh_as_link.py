"""Plain Zenoh with the session that links open, and a callback in Zenoh's own thread, as links have it."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from robbie_mp.connect.link.wire import Endpoints, open_session
from tools.bench.peers.peer import Handle, Send
from tools.bench.peers.zenoh_tcp import PORT_FILE, ZenohTcp, sender
from tools.bench.work import Work


class ZenohAsLink(ZenohTcp):
    """Two processes with a session each, as a link opens it, and nothing else of Robbie-MP."""

    title = "Zenoh with a link's settings"
    how = "a link's session over tcp and udp, express, struct; arrays as bytes; direct callback"

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Put messages."""
        with open_session(Endpoints(listen=[address(work)], datagrams=True)) as session:
            yield sender(session, work)

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Wait in the main thread while Zenoh's thread runs the callback."""
        import zenoh  # noqa: PLC0415

        ended = threading.Event()
        callback = zenoh.handlers.Callback(self.receiver(work, handle, ended), indirect=False)
        with open_session(Endpoints(connect=[address(work)], datagrams=True)) as session:
            session.declare_subscriber(work.topic, callback)
            ended.wait()


def address(work: Work) -> str:
    """Return the address at which the publisher listens."""
    return f"tcp/127.0.0.1:{(work.folder / PORT_FILE).read_text()}"


PEER = ZenohAsLink()
