"""QUIC (aioquic): a stream for each class that must arrive, and datagrams for commands and states."""

import asyncio
import ssl
import tempfile
import threading
from pathlib import Path

from aioquic.asyncio import QuicConnectionProtocol, connect, serve
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import DatagramFrameReceived, HandshakeCompleted, QuicEvent, StreamDataReceived

from robbie_mp.connect.link.keys import Keys
from tools.link.engines.side import KEPT, NEWEST_COUNTS, OnMessage

PORT = 7447
TOPICS = list(KEPT)
MAX_BULK = 3
"""Bulk messages that the receiver has not acknowledged: aioquic would keep any number."""
MAX_DATA = 1 << 22
HEAD_BYTES = 5


class TrialConnection(QuicConnectionProtocol):  # type: ignore[misc, unused-ignore]
    """One side of the connection. A message in a stream has its class and its size in front."""

    engine: "Quic"

    def quic_event_received(self, event: QuicEvent) -> None:
        """Take what arrives."""
        if isinstance(event, HandshakeCompleted):
            self.engine.is_up.set()
        elif isinstance(event, DatagramFrameReceived):
            self.engine.on_message(TOPICS[event.data[0]], event.data[1:])
        elif isinstance(event, StreamDataReceived):
            waiting = self.engine.begun.setdefault(event.stream_id, bytearray())
            waiting += event.data
            while len(waiting) >= HEAD_BYTES:
                topic, end = TOPICS[waiting[0]], HEAD_BYTES + int.from_bytes(waiting[1:HEAD_BYTES], "little")
                if len(waiting) < end:
                    break
                data = bytes(waiting[HEAD_BYTES:end])
                del waiting[:end]
                self.engine.take(topic, data)


class Quic:
    """An `Engine`."""

    def __init__(self, own: str, other: str, sends: list[str], on_message: OnMessage):
        self.on_message = on_message
        self.begun: dict[int, bytearray] = {}
        self._streams: dict[str, int] = {}
        self._bulk_room = threading.Semaphore(MAX_BULK)
        self.is_up = threading.Event()
        self._loop = asyncio.new_event_loop()
        opened = self._listen(own) if "bulk" in sends else self._connect(other)
        threading.Thread(target=self._loop.run_until_complete, args=(opened,), daemon=True).start()
        self.is_up.wait()

    def wait_for_room(self, topic: str) -> None:
        """Wait until the receiver has the last bulk messages."""
        if topic == "bulk":
            self._bulk_room.acquire()

    def send(self, topic: str, data: bytes) -> None:
        """Send a message."""
        self._loop.call_soon_threadsafe(self._send, topic, data)

    def take(self, topic: str, data: bytes) -> None:
        """Take a message of a stream; an empty one acknowledges bulk."""
        if data:
            self.on_message(topic, data)
            if topic == "bulk":
                self._send(topic, b"")
        else:
            self._bulk_room.release()

    def _send(self, topic: str, data: bytes) -> None:
        number, connection = TOPICS.index(topic), self._protocol._quic
        if topic in NEWEST_COUNTS:
            connection.send_datagram_frame(bytes([number]) + data)
        else:
            if topic not in self._streams:
                self._streams[topic] = connection.get_next_available_stream_id()
                connection.send_stream_data(self._streams[topic], b"")  # takes the number
            head = bytes([number]) + len(data).to_bytes(4, "little")
            connection.send_stream_data(self._streams[topic], head + data)
        self._protocol.transmit()

    def _use(self, protocol: TrialConnection) -> None:
        protocol.engine, self._protocol = self, protocol

    def _made(self, *arguments: object, **options: object) -> TrialConnection:
        protocol = TrialConnection(*arguments, **options)
        self._use(protocol)
        return protocol

    async def _listen(self, own: str) -> None:
        settings = _settings(is_client=False)
        with tempfile.TemporaryDirectory() as folder:
            keys = Keys(Path(folder))
            keys.make("robot")
            settings.load_cert_chain(keys.folder / "own.pem", keys.folder / "own.key")
        await serve(own, PORT, configuration=settings, create_protocol=self._made)
        await asyncio.Event().wait()

    async def _connect(self, other: str) -> None:
        settings = _settings(is_client=True)
        while True:
            try:
                async with connect(other, PORT, configuration=settings, create_protocol=self._made):
                    await asyncio.Event().wait()
            except ConnectionError:
                await asyncio.sleep(0.1)


def _settings(*, is_client: bool) -> QuicConfiguration:
    settings = QuicConfiguration(is_client=is_client, alpn_protocols=["trial"], max_datagram_frame_size=1200)
    settings.max_data = settings.max_stream_data = MAX_DATA
    settings.congestion_control_algorithm = "cubic"
    settings.verify_mode = ssl.CERT_NONE
    return settings


ENGINE = Quic
