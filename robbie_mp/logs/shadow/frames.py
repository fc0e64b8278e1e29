"""What the process of a shadow and the one that feeds it tell one another, over a socket."""

import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, TypeVar

import msgspec

from robbie_mp.base.errors import RobbieError

LENGTH = struct.Struct("<I")
MAX_FRAME_BYTES = 1 << 30
READ_BYTES = 1 << 18


class BrokenFrame(RobbieError, ValueError):
    """The process of a shadow has written into its socket what is no frame."""


class Begin(msgspec.Struct, tag=True):
    """What the shadow is: the first frame that it gets."""

    name: str
    class_path: str
    code: str
    workspace: str
    settings: dict[str, Any]
    topics: dict[str, str]
    namespace: str
    folder: str
    """Its results go there, and nothing else that it writes goes anywhere."""
    process_bytes: int | None


class Start(msgspec.Struct, tag=True):
    """The shadow is to run its setup now."""

    begin_ns: int
    checkpoint: bytes | None
    """What it restores."""


class Given(msgspec.Struct, tag=True):
    """A message for the shadow; without a type, only the time has passed."""

    time_ns: int
    """By the clock of the module, in ns since the epoch."""
    type_name: str = ""
    version: int = 0
    topic: str = ""
    sender: str = ""
    data: bytes = b""


class Ready(msgspec.Struct, tag=True):
    """The code of the shadow is imported."""


class Wants(msgspec.Struct, tag=True):
    """The shadow is set up, or has subscribed to more."""

    subscriptions: list[tuple[str, int, str, bool]]
    """Type, version (0: patterns), topic, and whether only the newest message is wanted."""


class Said(msgspec.Struct, tag=True):
    """The shadow would have published this."""

    time_ns: int
    type_name: str
    version: int
    topic: str
    data: bytes


class Done(msgspec.Struct, tag=True):
    """The shadow has handled what it was given last."""

    time_ns: int
    took_ns: int
    """0 if only the time has passed."""
    calls: int
    """How many calls it has made so far, which nobody answers."""


class EndedByError(msgspec.Struct, tag=True):
    """An exception has ended the shadow."""

    text: str


ToShadow = Begin | Start | Given
OfShadow = Ready | Wants | Said | Done | EndedByError
_encode = msgspec.msgpack.Encoder().encode
_Frame = TypeVar("_Frame")


def packed(frame: ToShadow | OfShadow) -> bytes:
    """Return a frame as it is sent."""
    data = _encode(frame)
    return LENGTH.pack(len(data)) + data


class Frames:
    """Takes frames out of what comes from a socket.

    Args:
        kind: the frames that may come.
    """

    def __init__(self, kind: Any):
        self._decode = msgspec.msgpack.Decoder(kind).decode
        self._buffer = bytearray()

    def add(self, data: bytes) -> Iterator[Any]:
        """Add bytes, and yield the frames that are whole.

        Raises:
            BrokenFrame: they are no frames.
        """
        buffer = self._buffer
        buffer += data
        at = 0
        while len(buffer) - at >= LENGTH.size:
            (size,) = LENGTH.unpack_from(buffer, at)
            if size > MAX_FRAME_BYTES:
                raise BrokenFrame(f"a frame of {size} bytes")
            end = at + LENGTH.size + size
            if len(buffer) < end:
                break
            try:
                frame = self._decode(bytes(buffer[at + LENGTH.size : end]))
            except msgspec.DecodeError as error:
                raise BrokenFrame(str(error)) from None
            at = end
            yield frame
        del buffer[:at]


def received(connection: socket.socket, kind: Any) -> Iterator[Any]:
    """Yield the frames that come until the other end closes, with or without having read all of ours."""
    frames = Frames(kind)
    with suppress(ConnectionResetError):
        while data := connection.recv(READ_BYTES):
            yield from frames.add(data)
