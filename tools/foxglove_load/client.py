"""A client of Foxglove's protocol that reads images and throws them away, or stops to read.

`client.py LINK NAME` reads until its input ends. For each line of input it prints the bytes read so far.
With `--stopped` it subscribes and reads no more.

Source: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import json
import socket
import struct
import sys
import threading
from urllib.parse import urlsplit

PROTOCOL = "foxglove.sdk.v1"
BUFFER_BYTES = 1 << 20
TEXT, CLOSED = 1, 8


class Client:
    """One connection.

    Args:
        link: the server's address with its token.
    """

    def __init__(self, link: str):
        place = urlsplit(link)
        self.bytes = 0
        self._socket = socket.create_connection((place.hostname or "", place.port or 0))
        self._socket.sendall(
            f"GET {place.path or '/'}?{place.query} HTTP/1.1\r\nHost: {place.netloc}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {PROTOCOL}\r\n\r\n".encode()
        )
        answer = b""
        while not answer.endswith(b"\r\n\r\n"):
            answer += self._take(1)
        if b" 101 " not in answer.partition(b"\r\n")[0]:
            raise ConnectionError(f"the server refuses: {answer!r}")

    def subscribe(self, topic: str) -> None:
        """Wait until the server has a topic, and subscribe to it."""
        channels: dict[str, int] = {}
        while topic not in channels:
            kind, size = self._frame()
            text = self._take(size)
            told = json.loads(text) if kind == TEXT else {}
            if told.get("op") == "advertise":
                channels |= {one["topic"]: one["id"] for one in told["channels"]}
        self._say({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channels[topic]}]})

    def read(self) -> None:
        """Read until the server closes the connection."""
        buffer = memoryview(bytearray(BUFFER_BYTES))
        while got := self._socket.recv_into(buffer):
            self.bytes += got

    def _say(self, told: dict[str, object]) -> None:
        text = json.dumps(told).encode()
        head = struct.pack("!BB", 0x80 | TEXT, 0x80 | len(text))  # short, and masked with zeros
        self._socket.sendall(head + bytes(4) + text)

    def _frame(self) -> tuple[int, int]:
        first, size = self._take(2)
        if first & 15 == CLOSED:
            raise ConnectionError("the server closes the connection")
        if size == 126:
            size = int.from_bytes(self._take(2), "big")
        elif size == 127:
            size = int.from_bytes(self._take(8), "big")
        return first & 15, size

    def _take(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            got = self._socket.recv(size - len(data))
            if not got:
                raise ConnectionError("the server closes the connection")
            data += got
        return data


def main() -> None:
    """Run the client."""
    client = Client(sys.argv[1])
    client.subscribe(f"/{sys.argv[2]}")
    if "--stopped" not in sys.argv:
        threading.Thread(target=client.read, daemon=True).start()
    print(0, flush=True)
    for _ in sys.stdin:
        print(client.bytes, flush=True)


if __name__ == "__main__":
    main()
