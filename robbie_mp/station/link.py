"""The connection to one browser, and whether it keeps up with what it is sent."""

from typing import Any

from robbie_mp.station.context import Link

LONGEST_QUEUE = 4
"""Packets that may wait for a browser. With as many waiting, its page is not changed any further."""
NAMESPACE = "/"


class BrowserLink(Link):
    """Knows how much is waiting for one browser.

    Socket.IO keeps what a browser has not taken, without a limit. So whoever has news for a page looks here
    first, and otherwise shows later what is the newest then.

    Args:
        server: sends to all browsers; a socketio.AsyncServer.
        client: the one.
    """

    def __init__(self, server: Any, client: str):
        self._server = server
        self._client = client

    @property
    def is_free(self) -> bool:
        """Whether there is a connection, and hardly anything waits for it."""
        waiting = [
            found.queue.qsize()
            for _, connection in self._server.manager.get_participants(NAMESPACE, self._client)
            if (found := self._server.eio.sockets.get(connection)) is not None
        ]
        # A browser that has come back may still have its former connection beside the new one.
        return bool(waiting) and min(waiting) < LONGEST_QUEUE
