"""A chunk of a log while it is filled: messages laid out as in the file, and how they are compressed."""

import struct
from array import array
from collections.abc import Sequence

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from strenum import StrEnum

RECORD_HEAD = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time, publish time."""
RECORD_HEAD_BYTES = RECORD_HEAD.size
_CONTENT_HEAD_BYTES = RECORD_HEAD.size - 9  # without opcode and length
_MESSAGE = int(Opcode.MESSAGE)
_pack = RECORD_HEAD.pack
ZSTD_LEVEL = 1
"""Compression level; low, because a robot has little time for it."""


class Chunk:
    """Whole message records, one after the other.

    The bytes of a message are copied once, to where they will be compressed or written from. (The library's
    own builder copies them four times, which for camera images is most of the cost of recording.)

    Attributes:
        data: the records.
        index: for each channel, log time and offset of each record, alternating.
        messages: number of messages.
        first_sequence: sequence number of the first message, in the order of the run.
        start_ns: log time of the earliest message.
        end_ns: log time of the latest message.
        opened_ns: when the first message arrived, on the machine's monotonic clock.
    """

    __slots__ = ("data", "end_ns", "first_sequence", "index", "messages", "opened_ns", "start_ns")

    def __init__(self, opened_ns: int):
        self.data = bytearray()
        self.index: dict[int, array[int]] = {}
        self.messages = 0
        self.first_sequence = 0
        self.start_ns = 0
        self.end_ns = 0
        self.opened_ns = opened_ns

    def add(
        self,
        channel_id: int,
        sequence: int,
        time_ns: int,
        data: bytes | memoryview,
        published_ns: int | None = None,
    ) -> None:
        """Copy a message in.

        Args:
            channel_id: its channel.
            sequence: its place in the order of the run.
            time_ns: its log time.
            data: its encoding.
            published_ns: when it was published; None: at its log time.
        """
        records = self.data
        if not self.messages:
            self.first_sequence = sequence
            self.start_ns = self.end_ns = time_ns
        elif time_ns > self.end_ns:
            self.end_ns = time_ns
        elif time_ns < self.start_ns:
            self.start_ns = time_ns
        self.messages += 1
        entries = self.index.get(channel_id)
        if entries is None:
            entries = self.index[channel_id] = array("Q")
        entries.append(time_ns)
        entries.append(len(records))
        length = _CONTENT_HEAD_BYTES + len(data)
        published_ns = time_ns if published_ns is None else published_ns
        records += _pack(_MESSAGE, length, channel_id, sequence & 0xFFFFFFFF, time_ns, published_ns)
        records += data

    def newest(self, channel_id: int) -> tuple[int, int, bytes]:
        """Return sequence number (modulo 2^32), log time and encoding of a channel's last message."""
        offset = self.index[channel_id][-1]
        _, length, _, sequence, time_ns, _ = RECORD_HEAD.unpack_from(self.data, offset)
        data = memoryview(self.data)[offset + RECORD_HEAD_BYTES : offset + length + 9]
        return sequence, time_ns, bytes(data)

    def counts(self) -> dict[int, int]:
        """Return the number of messages of each channel in the chunk."""
        return {channel_id: len(entries) // 2 for channel_id, entries in self.index.items()}


class Compression(StrEnum):
    """How the chunks of a log are compressed."""

    ZSTD = "zstd"
    LZ4 = "lz4"
    NONE = "none"

    @property
    def mcap_name(self) -> str:
        """The name of the compression in a chunk."""
        return "" if self is Compression.NONE else str(self)


def compress(pieces: Sequence[bytes | bytearray], compression: Compression) -> list[bytes | bytearray]:
    """Compress pieces as if they were one; without compression, nothing is copied."""
    size = sum(map(len, pieces))
    match compression:
        case Compression.ZSTD:
            stream = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compressobj(size=size)
            return [*(stream.compress(piece) for piece in pieces), stream.flush()]
        case Compression.LZ4:
            frame = lz4.frame.LZ4FrameCompressor()
            return [frame.begin(size), *(frame.compress(piece) for piece in pieces), frame.flush()]
        case _:
            return list(pieces)
