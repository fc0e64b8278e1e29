"""The door in front of Foxglove's server: it lets clients with the token pass, and counts what they get.

Foxglove's SDK asks no client for a password. So its server listens on a port of this machine that changes
with each start, and clients come through this door, which listens where the profile says. The door
reads the head of a client's request, compares the token in its address, and from then on passes bytes in
both directions. It also tells the server that the client came through the door (see `frames.greeting`).
"""

import asyncio
import contextlib
import hashlib
import hmac
import itertools
import logging
import socket
import threading
from collections.abc import Callable, Coroutine
from urllib.parse import parse_qs, urlsplit

from robbie_mp.errors import RobbieError
from robbie_mp.foxglove.frames import FrameCounter, greeting

READ_BYTES = 1 << 18
"""Most bytes of a client that wait in the door, in each direction."""
UNSENT_BYTES = 1 << 16
UNREAD_LIMIT_S = 20.0
"""A client that reads nothing for this time is disconnected."""
MAX_HEAD_BYTES = 1 << 14
HEAD_LIMIT_S = 5.0
WRONG_TOKEN_PAUSE_S = 1.0
START_LIMIT_S = 10.0
STOP_LIMIT_S = 3.0
BACKLOG = 16
_END = b"\r\n\r\n"
_SWITCHED = b"HTTP/1.1 101"


class DoorClosed(RobbieError, OSError):
    """Clients cannot come in.

    Example scenarios:
      - another program uses the port
      - the host is not an address of this machine
    """


class Passage:
    """A client that came through the door.

    Attributes:
        number: the client's number at the door, counted from 1.
        address: where the client is.
        bytes: bytes passed on to it.
    """

    def __init__(self, number: int, address: str):
        self.number = number
        self.address = address
        self.bytes = 0
        self._frames = FrameCounter()

    @property
    def messages(self) -> int:
        """Messages passed on to the client."""
        return self._frames.messages

    def note(self, data: bytes) -> None:
        """Count what is passed on."""
        self.bytes += len(data)
        self._frames.feed(data)


class Door:
    """Lets clients pass, in a thread.

    Args:
        host: address to listen on.
        port: port to listen on; 0: any free one.
        token: what clients must have in their address, as `?token=…`.
        greeting_topic: begins the topic in the greeting; the number of the client ends it.
        max_clients: most clients at a time.

    Raises:
        DoorClosed: the address cannot be used.

    Attributes:
        inside_port: the port of the server behind the door.
        passages: the clients that are connected.
        refused: clients that had a wrong token, or none, or were too many.
    """

    def __init__(self, host: str, port: int, token: str, greeting_topic: str, max_clients: int):
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._listener = socket.create_server((host, port), family=family, backlog=BACKLOG)
        except OSError as error:
            raise DoorClosed(
                f"cannot listen on {host}, port {port}: {error.strerror or error}; set another host or port"
            ) from error
        # Accepted connections inherit these options; tcp(7).
        unread_ms = round(UNREAD_LIMIT_S * 1000)
        self._listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, unread_ms)
        self._listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
        self.port: int = self._listener.getsockname()[1]
        self.inside_port = 0
        self.passages: dict[int, Passage] = {}
        self.refused = 0
        self._token = hashlib.sha256(token.encode()).digest()
        self._greeting_topic = greeting_topic
        self._max_clients = max_clients
        self._numbers = itertools.count(1)
        self._opened = threading.Event()
        self._stop: Callable[[], object] = lambda: None
        self._thread = threading.Thread(target=self._run, name="foxglove door", daemon=True)

    def open(self, inside_port: int) -> None:
        """Let clients in, to the server on a port of this machine.

        Raises:
            DoorClosed: the thread did not start.
        """
        self.inside_port = inside_port
        self._thread.start()
        if not self._opened.wait(START_LIMIT_S):
            raise DoorClosed("the door did not open; the trace of this module says why")

    def move(self, inside_port: int, greeting_topic: str) -> None:
        """Let clients in to another server; those that are connected lose the old one.

        Args:
            inside_port: its port.
            greeting_topic: as for the class.
        """
        self.inside_port, self._greeting_topic = inside_port, greeting_topic

    def close(self) -> None:
        """Disconnect all clients, and listen no longer."""
        self._stop()
        if self._thread.ident is not None:
            self._thread.join(STOP_LIMIT_S)
        self._listener.close()

    @property
    def is_open(self) -> bool:
        """Whether the thread still runs."""
        return self._thread.is_alive()

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        loop, stopped = asyncio.get_running_loop(), asyncio.Event()
        self._stop = lambda: loop.call_soon_threadsafe(stopped.set)
        clients: set[asyncio.Task[None]] = set()

        def on_client(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = loop.create_task(self._on_client(reader, writer))
            clients.add(task)
            task.add_done_callback(clients.discard)

        server = await asyncio.start_server(on_client, sock=self._listener, limit=READ_BYTES)
        self._opened.set()
        await stopped.wait()
        server.close()
        self._stop = lambda: None
        for task in clients:
            task.cancel()
        await asyncio.gather(*clients, return_exceptions=True)

    async def _on_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with contextlib.suppress(OSError, EOFError, asyncio.LimitOverrunError, TimeoutError):
                await self._receive(reader, writer)
        except Exception:
            logging.getLogger("foxglove door").exception("a client was disconnected")
        finally:
            writer.close()

    async def _receive(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async with asyncio.timeout(HEAD_LIMIT_S):
            head = await reader.readuntil(_END)
        if len(self.passages) >= self._max_clients:
            self.refused += 1
            await _answer(writer, "503 Service Unavailable")
        elif len(head) > MAX_HEAD_BYTES or not self._admits(head):
            self.refused += 1
            await asyncio.sleep(WRONG_TOKEN_PAUSE_S)
            await _answer(writer, "401 Unauthorized")
        else:
            await self._let_pass(head, reader, writer)

    def _admits(self, head: bytes) -> bool:
        """Whether the request has the token in its address. Every token takes the same time."""
        words = head.partition(b"\r\n")[0].split()
        query = urlsplit(words[1].decode("latin-1")).query if len(words) == 3 else ""
        given = parse_qs(query).get("token", [""])[0]
        return hmac.compare_digest(hashlib.sha256(given.encode()).digest(), self._token)

    async def _let_pass(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        number = next(self._numbers)
        passage = Passage(number, str(writer.get_extra_info("peername")[0]))
        self.passages[number] = passage
        try:
            inner = await asyncio.open_connection("127.0.0.1", self.inside_port, limit=READ_BYTES)
            from_inside, to_inside = inner
            try:
                to_inside.write(b"GET / HTTP/1.1\r\n" + head.partition(b"\r\n")[2])
                answer = await from_inside.readuntil(_END)
                writer.write(answer)
                if answer.startswith(_SWITCHED):
                    to_inside.write(greeting(f"{self._greeting_topic}{number}"))
                    await _first_of(
                        _pass_on(reader, to_inside, None), _pass_on(from_inside, writer, passage.note)
                    )
            finally:
                to_inside.close()
        finally:
            del self.passages[number]


async def _pass_on(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, note: Callable[[bytes], None] | None
) -> None:
    """Pass bytes on until the end. A reader who does not keep up makes the server behind the door wait."""
    writer.transport.set_write_buffer_limits(high=READ_BYTES)
    with contextlib.suppress(OSError):
        while data := await reader.read(READ_BYTES):
            if note is not None:
                note(data)
            writer.write(data)
            await writer.drain()


async def _first_of(*ways: Coroutine[None, None, None]) -> None:
    """Run both directions until one has ended."""
    tasks = [asyncio.ensure_future(way) for way in ways]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _answer(writer: asyncio.StreamWriter, status: str) -> None:
    writer.write(f"HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n".encode())
    await writer.drain()
