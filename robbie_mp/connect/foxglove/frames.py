"""The part of WebSocket frames (RFC 6455) and of Foxglove's protocol that the door reads.

Source of the protocol: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import base64
import hashlib
import json
import re
import secrets
from collections.abc import Mapping
from typing import Any

MESSAGE_DATA = 1
"""First byte of a binary frame from the server that carries a message."""
GREETING_CHANNEL = 2**32 - 1
PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""Names that clients have for the protocol; the newer first."""
WARNING, ERROR = 1, 2
"""Levels of texts for apps."""
POLICY = 1008
"""Why a connection is closed: what the client did is not allowed; RFC 6455, section 7.4.1."""
_HASHED_WITH_KEY = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
_TEXT, _BINARY, _CLOSE, _PONG, _LENGTH_2, _LENGTH_8 = 1, 2, 8, 10, 126, 127
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


def frame(kind: int, content: bytes) -> bytes:
    """Return a whole frame of a server."""
    size = len(content)
    if size < _LENGTH_2:
        length = bytes([size])
    elif size < 1 << 16:
        length = bytes([_LENGTH_2]) + size.to_bytes(2, "big")
    else:
        length = bytes([_LENGTH_8]) + size.to_bytes(8, "big")
    return bytes([0x80 | kind]) + length + content


def first_frame(data: bytes) -> bytes | None:
    """Return the frame of a server with which data begins; None if it is not all there."""
    end, size = _length(bytearray(data[:10]))
    return data[: end + size] if len(data) >= max(2, end) and len(data) >= end + size else None


def with_metadata(first: bytes, metadata: Mapping[str, str]) -> bytes:
    """Return the frame by which a server introduces itself, with more metadata; others as they are."""
    end, _ = _length(bytearray(first[:10]))
    if first[0] != 0x80 | _TEXT:
        return first
    try:
        told: Any = json.loads(first[end:])
    except ValueError:
        return first
    if not isinstance(told, dict) or told.get("op") != "serverInfo":
        return first
    told["metadata"] = {**(told.get("metadata") or {}), **metadata}
    return frame(_TEXT, json.dumps(told).encode())


def refusal(head: Mapping[str, str], why: str) -> bytes | None:
    """Return a handshake, a text that apps show, and the end of the connection; None if none is asked for.

    Apps show no reason of a connection that fails before the handshake.

    Args:
        head: the fields of the client's request; names in small letters.
        why: the text.
    """
    key, offered = head.get("sec-websocket-key", ""), head.get("sec-websocket-protocol", "")
    protocol = next((one for one in PROTOCOLS if one in re.split(r"\s*,\s*", offered)), "")
    if not key or not protocol:
        return None
    accept = base64.b64encode(hashlib.sha1(key.encode() + _HASHED_WITH_KEY, usedforsecurity=False).digest())
    answer = (
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Accept: {accept.decode()}\r\nSec-WebSocket-Protocol: {protocol}\r\n\r\n"
    )
    closes = frame(_CLOSE, POLICY.to_bytes(2, "big") + why.encode()[:120])
    return answer.encode() + status(ERROR, why) + closes


def status(level: int, text: str) -> bytes:
    """Return a frame with a text that apps show."""
    return frame(_TEXT, json.dumps({"op": "status", "level": level, "message": text}).encode())
