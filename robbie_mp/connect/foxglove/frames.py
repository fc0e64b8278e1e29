"""The part of WebSocket frames (RFC 6455) and of Foxglove's protocol that the door reads.

Source of the protocol: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import json
import secrets

MESSAGE_DATA = 1
"""First byte of a binary frame from the server that carries a message."""
GREETING_CHANNEL = 2**32 - 1
_BINARY, _PONG, _LENGTH_2, _LENGTH_8 = 2, 10, 126, 127
_NUMBER_BYTES = 8


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

    @property
    def is_between_frames(self) -> bool:
        """Whether all of the last frame has been fed, and nothing of the next one."""
        return not self.left and not self._head

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
        end, size = _length(head)
        if len(head) < end or (size and len(head) == end):
            return  # the first byte of the content says what it is
        if size:
            self.messages += (head[0] & 0x0F, head[-1]) == (_BINARY, MESSAGE_DATA)
            self.left = size - 1
        head.clear()


class PongReader:
    """Finds the pongs in what a client sends; it keeps nothing else."""

    def __init__(self) -> None:
        self._head = bytearray()
        self._left = 0
        self._pong: bytearray | None = None

    def feed(self, data: bytes) -> list[int]:
        """Return the numbers of the pings that a further part of the stream answers."""
        found: list[int] = []
        at = 0
        while at < len(data):
            if not self._left:
                self._head.append(data[at])
                at += 1
                self._read_head()
                continue
            part = data[at : at + self._left]
            self._left -= len(part)
            at += len(part)
            if self._pong is not None:
                self._pong += part
                if not self._left:
                    found.append(_unmasked(self._pong))
        return found

    def _read_head(self) -> None:
        head = self._head
        end, size = _length(head)
        is_masked = len(head) > 1 and head[1] & 0x80
        if len(head) < end + (4 if is_masked else 0):
            return
        is_pong = head[0] & 0x0F == _PONG and size == _NUMBER_BYTES
        self._pong = (head[end:] or bytearray(4)) if is_pong else None
        self._left = size
        self._head = bytearray()


def _length(head: bytearray) -> tuple[int, int]:
    """Return where the length in a frame's head ends, and the length of its content once it is there."""
    short = head[1] & 0x7F if len(head) > 1 else 0
    end = 2 + {_LENGTH_2: 2, _LENGTH_8: 8}.get(short, 0)
    return end, int.from_bytes(head[2:end], "big") if end > 2 else short


def _unmasked(pong: bytearray) -> int:
    """Return the number in a pong, which follows its mask."""
    mask, masked = pong[:4], pong[4:]
    return int.from_bytes(bytes(byte ^ mask[index % 4] for index, byte in enumerate(masked)), "big")


def ping(number: int) -> bytes:
    """Return a frame that every client answers at once with the same number; RFC 6455, section 5.5.2."""
    return bytes([0x89, _NUMBER_BYTES]) + number.to_bytes(_NUMBER_BYTES, "big")


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
