"""A link to a server with a limited rate: it reads the server's data only at the rate that you set."""

import asyncio
import math
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

PIECE = 4096
KERNEL_BYTES = 1 << 16
"""Amount of data that may be in transit beyond the rate."""


class NarrowLink:
    """Forwards connections to a server.

    Attributes:
        bytes_per_s: rate from the server, for all connections together. 0: no data passes. At first, the
            rate is not limited.
        port: port of this end.
    """

    def __init__(self, server_port: int):
        self._server_port = server_port
        self.bytes_per_s = math.inf
        self._free_s = 0.0
        self.port = 0

    async def serve(self, is_up: threading.Event) -> None:
        """Forward data until `end` is called."""
        self._loop, self._ends = asyncio.get_running_loop(), asyncio.Event()
        server = await asyncio.start_server(self._connected, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        is_up.set()
        await self._ends.wait()
        server.close()  # the end of this thread's event loop cuts the connections

    def end(self) -> None:
        """Cut all connections. Any thread may call this."""
        self._loop.call_soon_threadsafe(self._ends.set)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, KERNEL_BYTES)
        connection.setblocking(False)
        await asyncio.get_running_loop().sock_connect(connection, ("127.0.0.1", self._server_port))
        far_reader, far_writer = await asyncio.open_connection(sock=connection, limit=PIECE)
        try:
            await asyncio.gather(self._pass(reader, far_writer, False), self._pass(far_reader, writer, True))
        except OSError:
            pass  # one end has closed the connection
        finally:
            writer.close()
            far_writer.close()

    async def _pass(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, is_narrow: bool
    ) -> None:
        while piece := await reader.read(PIECE):
            if is_narrow:
                await self._wait_for_turn(len(piece))
            writer.write(piece)
            await writer.drain()
        writer.close()

    async def _wait_for_turn(self, size: int) -> None:
        while not self.bytes_per_s:
            await asyncio.sleep(0.1)
        self._free_s = max(self._free_s, time.monotonic()) + size / self.bytes_per_s
        await asyncio.sleep(self._free_s - time.monotonic())


@contextmanager
def narrow_link(server_port: int) -> Iterator[NarrowLink]:
    """Run a link in a separate thread."""
    link, is_up = NarrowLink(server_port), threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(link.serve(is_up)), daemon=True)
    thread.start()
    is_up.wait()
    try:
        yield link
    finally:
        link.end()
        thread.join()
