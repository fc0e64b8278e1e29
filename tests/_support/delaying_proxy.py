"""A TCP proxy on this machine that delays what passes, as a long way does, and limits its rate."""

import asyncio
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

CHUNK_BYTES, SLOW_CHUNK_BYTES = 1 << 16, 1 << 11
QUEUE_S = 0.3
"""When more than this is queued, the proxy stops reading, so the rest waits at the sender."""


class DelayingProxy:
    """Forwards connections to a port of this machine.

    Args:
        target_port: the port.
        delay_s: each way; may be changed, for what comes from then on.
        bytes_per_s: rate of all that the port answers, together.

    Attributes:
        port: on which it listens.
    """

    def __init__(self, target_port: int, delay_s: float = 0.0, bytes_per_s: float = math.inf):
        self.delay_s = delay_s
        self.port = 0
        self._target_port = target_port
        self._bytes_per_s = bytes_per_s
        self._free_s = 0.0
        self._loop = asyncio.new_event_loop()
        self._is_ready = threading.Event()
        self._end = asyncio.Event()
        self._thread = threading.Thread(target=lambda: self._loop.run_until_complete(self._serve()))

    def start(self) -> None:
        """Listen."""
        self._thread.start()
        assert self._is_ready.wait(10.0)

    def close(self) -> None:
        """End all connections."""
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join()
        self._loop.close()

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._forward, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        self._is_ready.set()
        await self._end.wait()
        server.close()
        own = asyncio.current_task()
        others = [task for task in asyncio.all_tasks() if task is not own]
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target_port)
        ways = [self._read(reader, far_writer, math.inf), self._read(far_reader, writer, self._bytes_per_s)]
        try:
            await asyncio.gather(*ways)
        except asyncio.CancelledError:
            pass
        finally:
            for one in (writer, far_writer):
                one.transport.abort()

    async def _read(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, bytes_per_s: float
    ) -> None:
        """Pass on what comes, in its order, and then the end of the connection."""
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        sending = asyncio.create_task(self._write(waiting, writer))
        data = b"?"
        while data:
            try:
                data = await reader.read(CHUNK_BYTES if bytes_per_s == math.inf else SLOW_CHUNK_BYTES)
            except ConnectionError:
                data = b""
            way_s = self._queue_s(len(data) / bytes_per_s)
            waiting.put_nowait((self._loop.time() + way_s + self.delay_s, data))
            if way_s > QUEUE_S:
                await asyncio.sleep(way_s - QUEUE_S)
        await sending

    def _queue_s(self, costs_s: float) -> float:
        """Return the time until something has passed that takes some time."""
        if not costs_s:
            return 0.0
        self._free_s = max(self._free_s, self._loop.time()) + costs_s
        return self._free_s - self._loop.time()

    async def _write(self, waiting: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError, OSError):
            while True:
                due_s, data = await waiting.get()
                await asyncio.sleep(max(0.0, due_s - self._loop.time()))
                if not data:
                    writer.write_eof()
                    return
                writer.write(data)
                await writer.drain()


@contextmanager
def delaying_proxy(
    target_port: int, delay_s: float = 0.0, bytes_per_s: float = math.inf
) -> Iterator[DelayingProxy]:
    """Run a proxy; see there."""
    proxy = DelayingProxy(target_port, delay_s, bytes_per_s)
    proxy.start()
    try:
        yield proxy
    finally:
        proxy.close()
