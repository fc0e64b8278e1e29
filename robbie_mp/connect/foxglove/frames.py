"""The part of WebSocket frames (RFC 6455) and of Foxglove's protocol that the door reads.

Source of the protocol: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import json
import secrets

MESSAGE_DATA = 1
"""First byte of a binary frame from the server that carries a message."""
GREETING_CHANNEL = 2**32 - 1
_BINARY, _LENGTH_2, _LENGTH_8 = 2, 126, 127


class FrameCounter:
    """Counts the frames with messages in what a server sends; it keeps none of it.

    Attributes:
        messages: the number of messages.
        left: bytes of the present frame that are still to come, and need not be fed.
    """

    def __init__(self) -> None:
        self.messages = 0
        self.left = 0
        self._head = bytearray()

    def feed(self, data: bytes) -> None:
        """Count the frames that begin in a further part of the stream."""
        at = 0
        while at < len(data):
            if self.left:
                skipped = min(self.left, len(data) - at)
                self.left -= skipped
                at += skipped
                continue
            self._head.append(data[at])
            at += 1
            self._read_head()

    def _read_head(self) -> None:
        head = self._head
        if len(head) < 2:
            return
        short = head[1] & 0x7F
        size_bytes = {_LENGTH_2: 2, _LENGTH_8: 8}.get(short, 0)
        if len(head) < 2 + size_bytes:
            return
        size = int.from_bytes(head[2 : 2 + size_bytes], "big") if size_bytes else short
        if size and len(head) == 2 + size_bytes:
            return  # the first byte of the content says what it is
        if size:
            self.messages += (head[0] & 0x0F, head[-1]) == (_BINARY, MESSAGE_DATA)
            self.left = size - 1
        head.clear()


def greeting(topic: str) -> bytes:
    """Return the frame by which the door tells the server which client comes through it.

    It is a client's announcement of a channel, because clients can say nothing else with a name in it.

    Args:
        topic: the channel's topic, which only the door and the server know.
    """
    channel = {"id": GREETING_CHANNEL, "topic": topic, "encoding": "cdr", "schemaName": ""}
    text = json.dumps({"op": "advertise", "channels": [channel]}).encode()
    mask = secrets.token_bytes(4)
    masked = bytes(byte ^ mask[index % 4] for index, byte in enumerate(text))
    return b"\x81" + bytes([0x80 | _LENGTH_2]) + len(text).to_bytes(2, "big") + mask + masked
