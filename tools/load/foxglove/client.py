"""A client of Foxglove's protocol that reads images and throws them away, or stops to read.

`client.py LINK NAME` reads until its input ends. For each line of input it prints the bytes read so far; for
the line `press` it presses the emergency stop and prints when, in ns of the monotonic clock. With `--stopped`
it subscribes and reads no more. With `--elsewhere` it takes only the processor time that the robot leaves, as
if it ran on another machine.

Source: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import json
import logging
import socket
import struct
import sys
import threading
import time
from urllib.parse import urlsplit

from robbie_mp.base.linux.priority import lower_priority

PROTOCOL = "foxglove.sdk.v1"
BUFFER_BYTES = 1 << 16
"""Small, because many kernels let nobody interrupt them while they copy."""
NICE = 19
TEXT, BINARY, CLOSED = 1, 2, 8
CALL = 2
"""First byte of a client's binary frame that calls a service."""
STOP = "/emergency_stop/engage"
EMPTY_REQUEST = b"\x00\x01\x00\x00"


class Client:
    """One connection.

    Args:
        link: the server's address with its token.
    """

    def __init__(self, link: str):
        place = urlsplit(link)
        self.bytes = 0
        self._stop_service = 0
        self._calls = 0
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
        """Wait until the server has a topic and the emergency stop, and subscribe to the topic."""
        channels: dict[str, int] = {}
        while topic not in channels or not self._stop_service:
            kind, size = self._frame()
            text = self._take(size)
            told = json.loads(text) if kind == TEXT else {}
            if told.get("op") == "advertise":
                channels |= {one["topic"]: one["id"] for one in told["channels"]}
            elif told.get("op") == "advertiseServices":
                self._stop_service = {one["name"]: one["id"] for one in told["services"]}[STOP]
        self._say({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channels[topic]}]})

    def read(self) -> None:
        """Read until the server closes the connection."""
        buffer = memoryview(bytearray(BUFFER_BYTES))
        while got := self._socket.recv_into(buffer):
            self.bytes += got

    def press_stop(self) -> int:
        """Press the emergency stop; return when, ns."""
        self._calls += 1
        call = struct.pack("<BIII", CALL, self._stop_service, self._calls, len("cdr")) + b"cdr"
        now_ns = time.monotonic_ns()
        self._send(BINARY, call + EMPTY_REQUEST)
        return now_ns

    def _say(self, told: dict[str, object]) -> None:
        self._send(TEXT, json.dumps(told).encode())

    def _send(self, kind: int, data: bytes) -> None:
        head = struct.pack("!BB", 0x80 | kind, 0x80 | len(data))  # short, and masked with zeros
        self._socket.sendall(head + bytes(4) + data)

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
    if "--elsewhere" in sys.argv:
        lower_priority(NICE, logging.getLogger())
    client = Client(sys.argv[1])
    client.subscribe(f"/{sys.argv[2]}")
    if "--stopped" not in sys.argv:
        threading.Thread(target=client.read, daemon=True).start()
    print(0, flush=True)
    for line in sys.stdin:
        print(client.press_stop() if line == "press\n" else client.bytes, flush=True)


if __name__ == "__main__":
    main()
