"""The door in front of Foxglove's server: it lets clients with the token pass, and counts what they get.

Foxglove's SDK asks no client for a password. So its server listens on a port of this machine that changes
with each start, and clients come through this door, which listens where the profile says. The door
reads the head of a client's request, compares the token in its address, and from then on passes bytes in
both directions. It also tells the server that the client came through the door (see `frames.greeting`).

Where clients may drive the robot, the door pings them. What a client sends after its answer to a ping was
sent after that ping. This bounds its age, whatever the client's clock says and however slow the network is.
"""

import asyncio
import contextlib
import hashlib
import hmac
import itertools
import logging
import math
import os
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterator, Mapping
from urllib.parse import parse_qs, urlsplit

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.foxglove.frames import (
    WARNING,
    FrameCounter,
    PongReader,
    first_frame,
    greeting,
    ping,
    refusal,
    status,
    with_metadata,
)

PIECE_BYTES = 1 << 16
"""Most bytes that are passed on at once: many kernels let nobody interrupt them meanwhile."""
TURN_BYTES = 1 << 18
"""Most bytes for a client before it is the turn of the others."""
SMALL_BYTES = 1 << 14
"""Messages up to this size are read and written, which costs less than two calls of splice(2) for each."""
UNSENT_BYTES = 1 << 16
UNREAD_LIMIT_S = 20.0
"""A client that reads nothing for this time is disconnected."""
MAX_HEAD_BYTES = 1 << 14
MAX_INTRODUCTION_BYTES = 1 << 20
METADATA = {"ROS_DISTRO": "jazzy"}
"""Tells apps that messages and definitions are those of ROS 2; then they publish poses and velocities, too.

The SDK has no argument for it.
"""
WRONG_TOKEN = "this link has another token than the robot; `robbie foxglove` on the robot prints the link"
HEAD_LIMIT_S = 5.0
WRONG_TOKEN_PAUSE_S = 1.0
ACCEPT_PAUSE_S = 0.5
START_LIMIT_S = 10.0
STOP_LIMIT_S = 3.0
BACKLOG = 16
PING_PERIOD_S = 0.05
MIN_WAIT_S = 0.005
SETTLES_S = 0.05
"""An answer to a ping counts after this time: then the server has taken what the client sent before it."""
MAX_PINGS = 256
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
        notice: a text for this client alone, which it gets between two frames; "": none.

    Args:
        is_pinged: whether the age of what it sends is to be known.
    """

    def __init__(self, number: int, address: str, is_pinged: bool):
        self.number = number
        self.address = address
        self.bytes = 0
        self.notice = ""
        self._frames = FrameCounter()
        self._pongs = PongReader()
        self._is_pinged = is_pinged
        self._ping_at_s = 0.0
        self._sent_s: deque[tuple[int, float]] = deque(maxlen=MAX_PINGS)
        """Number and time of the pings without an answer."""
        self._answered_s: deque[tuple[float, float]] = deque(maxlen=MAX_PINGS)
        """From when on answers count, and when their pings were sent."""
        self._follows_s = -math.inf

    @property
    def greatest_age_s(self) -> float:
        """How old what comes from the client now can be at most; infinite if that is not known."""
        now_s = time.monotonic()
        while self._answered_s and self._answered_s[0][0] <= now_s:
            self._follows_s = self._answered_s.popleft()[1]
        return now_s - self._follows_s

    @property
    def ping_in_s(self) -> float | None:
        """When the next ping is due; None if there are none."""
        return self._ping_at_s - time.monotonic() if self._is_pinged else None

    @property
    def is_between_frames(self) -> bool:
        """Whether a ping can be sent now."""
        return self._frames.is_between_frames

    def ping(self) -> bytes:
        """Return a ping, which is sent now."""
        number, now_s = secrets.randbits(64), time.monotonic()
        self._sent_s.append((number, now_s))
        self._ping_at_s = now_s + PING_PERIOD_S
        return ping(number)

    def take_notice(self) -> bytes:
        """Return the frame with the text for the client, once; empty if there is none, or not now."""
        if not self.notice or not self.is_between_frames:
            return b""
        text, self.notice = self.notice, ""
        return status(WARNING, text)

    def hear(self, data: bytes) -> None:
        """Note the answers to pings in what the client sends."""
        if not self._is_pinged:
            return
        for number in self._pongs.feed(data):
            if any(number == one for one, _ in self._sent_s):
                while (sent := self._sent_s.popleft())[0] != number:
                    pass  # clients may answer only the newest of several pings
                self._answered_s.append((time.monotonic() + SETTLES_S, sent[1]))

    @property
    def messages(self) -> int:
        """Messages passed on to the client."""
        return self._frames.messages

    @property
    def left(self) -> int:
        """Bytes of the present message that are still to come."""
        return self._frames.left

    def note(self, data: bytes) -> None:
        """Count what is passed on."""
        self.bytes += len(data)
        self._frames.feed(data)

    def skip(self, size: int) -> None:
        """Count bytes of the present message that are passed on unseen."""
        self.bytes += size
        self._frames.left -= size


class ClientDoor:
    """Lets clients pass, in a thread.

    Args:
        host: address to listen on.
        port: port to listen on; 0: any free one.
        token: what clients must have in their address, as `?token=…`.
        greeting_topic: begins the topic in the greeting; the number of the client ends it.
        max_clients: most clients at a time.
        pings: whether the age of what clients send is to be known.

    Raises:
        DoorClosed: the address cannot be used.

    Attributes:
        inside_port: the port of the server behind the door.
        passages: the clients that are connected.
        refused: clients that had a wrong token, or none, or were too many.
    """

    def __init__(
        self, host: str, port: int, token: str, greeting_topic: str, max_clients: int, *, pings: bool = False
    ):
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
        self._pings = pings
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
        self._listener.setblocking(False)
        clients: set[asyncio.Task[None]] = set()
        accepts = loop.create_task(self._accept(clients))
        self._opened.set()
        await stopped.wait()
        self._stop = lambda: None
        tasks = [accepts, *clients]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _accept(self, clients: set[asyncio.Task[None]]) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                client, address = await loop.sock_accept(self._listener)
            except OSError:  # such as too many open files
                await asyncio.sleep(ACCEPT_PAUSE_S)
                continue
            task = loop.create_task(self._on_client(client, str(address[0])))
            clients.add(task)
            task.add_done_callback(clients.discard)

    async def _on_client(self, client: socket.socket, address: str) -> None:
        with client:
            try:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                await self._receive(client, address)
            except (OSError, EOFError, asyncio.TimeoutError):  # it has gone, or was too slow
                pass
            except Exception:
                logging.getLogger("foxglove door").exception("a client was disconnected")

    async def _receive(self, client: socket.socket, address: str) -> None:
        head, rest = await asyncio.wait_for(_head_from(client), HEAD_LIMIT_S)
        if len(self.passages) >= self._max_clients:
            self.refused += 1
            why = f"{len(self.passages)} clients are connected, which is the limit (`max_clients`)"
            await _refuse(client, head, "503 Service Unavailable", why)
        elif not self._admits(head):
            self.refused += 1
            await asyncio.sleep(WRONG_TOKEN_PAUSE_S)
            await _refuse(client, head, "401 Unauthorized", WRONG_TOKEN)
        else:
            await self._let_pass(head, rest, client, address)

    def _admits(self, head: bytes) -> bool:
        """Whether the request has the token in its address. Every token takes the same time."""
        words = head.partition(b"\r\n")[0].split()
        query = urlsplit(words[1].decode("latin-1")).query if len(words) == 3 else ""
        given = parse_qs(query).get("token", [""])[0]
        return hmac.compare_digest(hashlib.sha256(given.encode()).digest(), self._token)

    async def _let_pass(self, head: bytes, rest: bytes, client: socket.socket, address: str) -> None:
        loop, number = asyncio.get_running_loop(), next(self._numbers)
        passage = Passage(number, address, self._pings)
        self.passages[number] = passage
        try:
            with socket.socket() as inner:
                inner.setblocking(False)
                inner.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                await loop.sock_connect(inner, ("127.0.0.1", self.inside_port))
                await loop.sock_sendall(inner, b"GET / HTTP/1.1\r\n" + head.partition(b"\r\n")[2])
                answer, first = await _head_from(inner)
                await loop.sock_sendall(client, answer)
                if answer.startswith(_SWITCHED):
                    greets = greeting(f"{self._greeting_topic}{number}")
                    first = await asyncio.wait_for(_introduction(inner, first), HEAD_LIMIT_S)
                    await _first_of(
                        _pass_in(client, inner, passage, greets, rest),
                        _pass_out(inner, client, passage, first),
                    )
        finally:
            del self.passages[number]


async def _head_from(sender: socket.socket) -> tuple[bytes, bytes]:
    """Return the head of a request or of an answer, and what has come behind it.

    Raises:
        EOFError: it has no end, or is too large.
    """
    loop, data = asyncio.get_running_loop(), b""
    while _END not in data:
        got = await loop.sock_recv(sender, MAX_HEAD_BYTES)
        if not got or len(data) > MAX_HEAD_BYTES:
            raise EOFError
        data += got
    head, end, rest = data.partition(_END)
    return head + end, rest


async def _pass_in(
    client: socket.socket, inner: socket.socket, passage: Passage, greets: bytes, data: bytes
) -> None:
    """Pass on what the client sends, behind the greeting and what has come already, until its end."""
    loop = asyncio.get_running_loop()
    await loop.sock_sendall(inner, greets)
    data = data or await loop.sock_recv(client, PIECE_BYTES)
    while data:
        passage.hear(data)
        await loop.sock_sendall(inner, data)
        data = await loop.sock_recv(client, PIECE_BYTES)


async def _pass_out(inner: socket.socket, client: socket.socket, passage: Passage, data: bytes) -> None:
    """Pass on what the server sends, behind some data, until its end.

    A reader who does not keep up makes the server behind the door wait. Of large messages, this process
    sees only the beginning: the kernel passes the rest on, splice(2).
    """
    loop, turn_ends_at = asyncio.get_running_loop(), TURN_BYTES
    with _pipe() as pipe:
        while True:
            passage.note(data)
            await loop.sock_sendall(client, data)
            while passage.left > SMALL_BYTES:
                passage.skip(await _splice(inner, client, pipe, min(passage.left, PIECE_BYTES)))
                if passage.bytes >= turn_ends_at:  # it may be that neither end has to be waited for
                    turn_ends_at = passage.bytes + TURN_BYTES
                    await asyncio.sleep(0)
            await asyncio.sleep(0)
            data = await _from_server(inner, client, passage)
            if not data:
                return


async def _from_server(inner: socket.socket, client: socket.socket, passage: Passage) -> bytes:
    """Wait for what the server sends next, and ping the client meanwhile, between two frames."""
    loop = asyncio.get_running_loop()
    while True:
        wait_s, size = passage.ping_in_s, SMALL_BYTES
        if notice := passage.take_notice():
            await loop.sock_sendall(client, notice)
        if wait_s is not None and wait_s <= 0.0:
            if passage.is_between_frames:
                await loop.sock_sendall(client, passage.ping())
            else:
                size = passage.left or 1  # up to the end of the frame
        try:
            return inner.recv(size)
        except BlockingIOError:
            limit_s = None if wait_s is None else max(wait_s, MIN_WAIT_S)
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(_ready(inner, loop.add_reader, loop.remove_reader), limit_s)


async def _splice(inner: socket.socket, client: socket.socket, pipe: tuple[int, int], size: int) -> int:
    """Pass on at most this number of bytes; return how many.

    Raises:
        EOFError: the server has closed the connection.
    """
    loop, (pipe_out, pipe_in) = asyncio.get_running_loop(), pipe
    while True:
        try:
            taken = os.splice(inner.fileno(), pipe_in, size, flags=os.SPLICE_F_NONBLOCK)
            break
        except BlockingIOError:
            await _ready(inner, loop.add_reader, loop.remove_reader)
    if not taken:
        raise EOFError
    left = taken
    while left:
        try:
            left -= os.splice(pipe_out, client.fileno(), left, flags=os.SPLICE_F_NONBLOCK)
        except BlockingIOError:
            await _ready(client, loop.add_writer, loop.remove_writer)
    return taken


async def _ready(end: socket.socket, add: Callable[..., None], remove: Callable[[int], bool]) -> None:
    """Wait until an end of a passage can be read from, or written to."""
    ready = asyncio.Event()
    add(end.fileno(), ready.set)
    try:
        await ready.wait()
    finally:
        remove(end.fileno())


@contextlib.contextmanager
def _pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        yield ends
    finally:
        for end in ends:
            os.close(end)


async def _first_of(*ways: Coroutine[None, None, None]) -> None:
    """Run both directions until one has ended."""
    tasks = [asyncio.ensure_future(way) for way in ways]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _introduction(inner: socket.socket, data: bytes) -> bytes:
    """Return the frame by which the server introduces itself, with our metadata, and what came behind it.

    Raises:
        EOFError: it has no end, or is too large.
    """
    loop = asyncio.get_running_loop()
    while (first := first_frame(data)) is None:
        got = await loop.sock_recv(inner, PIECE_BYTES)
        if not got or len(data) > MAX_INTRODUCTION_BYTES:
            raise EOFError
        data += got
    return with_metadata(first, METADATA) + data[len(first) :]


async def _refuse(client: socket.socket, head: bytes, code: str, why: str) -> None:
    """Refuse a client: by a text that an app shows, or to other programs by a status of HTTP."""
    text = f"HTTP/1.1 {code}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    answer = refusal(_fields(head), why) or text.encode()
    await asyncio.get_running_loop().sock_sendall(client, answer)


def _fields(head: bytes) -> Mapping[str, str]:
    lines = head.decode("latin-1").split("\r\n")[1:]
    return {name.strip().lower(): value.strip() for name, _, value in (one.partition(":") for one in lines)}
