"""The page server in a thread of the module's process."""

import asyncio
import socket
import threading
import time
from functools import partial
from typing import cast

import uvicorn

from robbie_mp.base.errors import RobbieError
from robbie_mp.station.web.connections import BoundedHttp, BoundedWebSocket, Connections
from robbie_mp.station.web.gate import App
from robbie_mp.station.web.listening import BACKLOG

START_LIMIT_S = 10.0
STOP_LIMIT_S = 2.0
MAX_MESSAGE_BYTES = 1 << 17
"""Maximum size of a message from a page. A page that sends a larger one is disconnected."""
MAX_HEADERS_BYTES = 1 << 14
"""Maximum size of a request's headers, including cookies."""

HEADERS = [
    (
        "content-security-policy",
        "frame-ancestors 'none'; base-uri 'self'; form-action 'self'; object-src 'none'",
    ),
    ("x-frame-options", "DENY"),
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
]
"""Headers that keep other sites from showing the page in a frame (clickjacking) or using its pictures."""


class ServerFailed(RobbieError, RuntimeError):
    """The page server did not start, or has ended."""


class PageServer:
    """Serves an application until it is closed.

    Args:
        app: the application.
        listener: the socket on which the server listens. `close` closes it, too.
        connections: count and limit the connections.
    """

    def __init__(self, app: App, listener: socket.socket, connections: Connections):
        self._socket = listener
        # h11 and wsproto bound the stored data of a request; uvicorn's alternatives do not, or are obsolete.
        config = uvicorn.Config(
            app,
            log_config=None,
            log_level="warning",
            access_log=False,
            http=cast(type[asyncio.Protocol], partial(BoundedHttp, connections)),
            ws=cast(type[asyncio.Protocol], partial(BoundedWebSocket, connections)),
            ws_max_size=MAX_MESSAGE_BYTES,
            h11_max_incomplete_event_size=MAX_HEADERS_BYTES,
            backlog=BACKLOG,
            headers=HEADERS,
            # Forwarding headers are read behind the count of connections, whose other end is the proxy.
            proxy_headers=False,
            # Large data is compressed already, and the event loop would compress it again for each page.
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, args=([self._socket],), name="page server", daemon=True
        )

    def start(self) -> None:
        """Start the server.

        Raises:
            ServerFailed: the server does not start.
        """
        self._thread.start()
        deadline_s = time.monotonic() + START_LIMIT_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > deadline_s:
                raise ServerFailed("the page server did not start; the trace of this module says why")
            time.sleep(0.005)

    def check(self) -> None:
        """Check that the server still runs.

        Raises:
            ServerFailed: the server has ended.
        """
        if not self._thread.is_alive():
            raise ServerFailed("the page server has ended; the trace of this module says why")

    def close(self) -> None:
        """Stop serving, and close all connections."""
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join(STOP_LIMIT_S)
        self._socket.close()
