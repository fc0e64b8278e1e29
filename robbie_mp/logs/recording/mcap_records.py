"""The records of MCAP files; each record is checked to be complete before it is read.

Source: https://mcap.dev/spec. The library `mcap` parses records, but trusts their lengths. In a truncated
    file it returns a shortened last message, and a wrong length makes it request that much memory. So this
    module reads every length itself, and compares it with the bytes there are.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple, Protocol, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Chunk

from robbie_mp.logs.recording.errors import LogDamaged, LogLimitExceeded
from robbie_mp.logs.recording.limits import READ_LIMITS, ReadLimits

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
DECOMPRESSED_PIECE_BYTES = 1 << 20

_Record_co = TypeVar("_Record_co", covariant=True)


class Frame(NamedTuple):
    """The position of a record."""

    opcode: int
    start: int
    """Offset of the content, after opcode and length."""
    length: int
    """Length of the content."""

    @property
    def end(self) -> int:
        """Offset of the next record."""
        return self.start + self.length


class _Readable(Protocol[_Record_co]):
    @staticmethod
    def read(stream: ReadDataStream) -> _Record_co:
        """Parse a record."""


class _ExactStream(ReadDataStream):
    """Raises an error where mcap's own stream would return fewer bytes than requested."""

    def __init__(self, data: bytes):
        super().__init__(BytesIO(data))
        self._size = len(data)

    def read(self, length: int) -> bytes:
        if length > self._size - self.count:
            raise EndOfFile
        return super().read(length)


def frame_at(file: BinaryIO, offset: int, size: int) -> Frame:
    """Return the frame of the record at an offset of a file of the given size.

    Raises:
        LogDamaged: there is no complete record.
    """
    file.seek(offset)
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise LogDamaged("the file ends in a record")
    opcode, length = RECORD_HEAD.unpack(head)
    frame = Frame(opcode, offset + RECORD_HEAD.size, length)
    if opcode == 0:
        raise LogDamaged("there is no record")
    if frame.end > size:
        raise LogDamaged(f"the record should end at byte {frame.end}, but the file ends at {size}")
    return frame


def content(file: BinaryIO, frame: Frame, limits: ReadLimits = READ_LIMITS) -> bytes:
    """Read the content of a record.

    Raises:
        LogDamaged: the file has become shorter.
        LogLimitExceeded: the content is too large.
    """
    limits.check_chunk(frame.length)
    file.seek(frame.start)
    data = file.read(frame.length)
    if len(data) < frame.length:
        raise LogDamaged(f"the file has become shorter than byte {frame.end}")
    return data


def parse(kind: _Readable[_Record_co], data: bytes) -> _Record_co:
    """Parse the content of a record.

    Args:
        kind: its class in `mcap.records`; not Message, whose length is the length of the record.
        data: the content.

    Raises:
        LogDamaged: the content is not such a record.
    """
    return _parse(kind, data)[0]


def _parse(kind: _Readable[_Record_co], data: bytes) -> tuple[_Record_co, int]:
    """Parse the content of a record; return where the fields end that are known: more may follow."""
    stream = _ExactStream(data)
    try:
        return kind.read(stream), stream.count
    except (McapError, ValueError, struct.error) as error:
        name = getattr(kind, "__name__", "record")
        why = str(error) or "too short"
        raise LogDamaged(f"a {name} record of {len(data)} bytes cannot be read: {why}") from error


def read_attachment(data: bytes) -> Attachment:
    """Parse the content of an attachment, and verify its checksum if there is one.

    Raises:
        LogDamaged: it is not what was written.
    """
    attachment: Attachment
    attachment, end = _parse(Attachment, data)
    checksum = int.from_bytes(data[end - 4 : end], "little")
    if checksum and zlib.crc32(data[: end - 4]) != checksum:
        raise LogDamaged(f"the attachment {attachment.name!r} does not match its checksum")
    return attachment


def chunk_data(chunk: Chunk, limits: ReadLimits = READ_LIMITS) -> bytes:
    """Return the decompressed records of a chunk, and verify their checksum if there is one.

    It never decompresses more than the chunk states, nor more than the limit.

    Raises:
        LogDamaged: they are not what was written, or their compression is unknown.
        LogLimitExceeded: there are more bytes than the limit allows.
    """
    size = chunk.uncompressed_size
    try:
        data = _decompress(chunk.compression, chunk.data, size, limits)
    except LogLimitExceeded:
        raise
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise LogDamaged(f"a chunk cannot be decompressed: {error}") from error
    if len(data) != size:
        raise LogDamaged(f"a chunk has {len(data)} bytes instead of the stated {size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise LogDamaged("a chunk does not match its checksum")
    return data


def _decompress(compression: str, data: bytes, size: int, limits: ReadLimits) -> bytes:
    """Decompress; a stated size that the data do not confirm counts as damage, not as a chunk too large."""
    if compression == "":
        return data
    if compression == "zstd":
        known = zstandard.frame_content_size(data)
        if known == -1:
            return _unfold(zstandard.ZstdDecompressor().stream_reader(data).read, size, limits)
        if known != size:
            raise ValueError("its frame is of another size")
        limits.check_chunk(size)
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    if compression == "lz4":
        decompressor = lz4.frame.LZ4FrameDecompressor()
        rest = data

        def read(count: int) -> bytes:
            nonlocal rest
            piece: bytes = b"" if decompressor.eof else decompressor.decompress(rest, max_length=count)
            rest = b""  # the decompressor keeps the rest of its input
            return piece

        return _unfold(read, size, limits)
    raise ValueError(f"this program does not know the compression {compression!r}")


def _unfold(read: Callable[[int], bytes], size: int, limits: ReadLimits) -> bytes:
    """Read piece by piece, and no more than the limit."""
    pieces: list[bytes] = []
    found = 0
    while found < size and (piece := read(min(DECOMPRESSED_PIECE_BYTES, size - found))):
        pieces.append(piece)
        found += len(piece)
        if found > limits.chunk_bytes:
            limits.check_chunk(size)
    return b"".join(pieces)


def frames_in(data: bytes) -> Iterator[Frame]:
    """Yield the frames of consecutive records in `data`.

    Raises:
        LogDamaged: the last record is not complete.
    """
    offset, size = 0, len(data)
    while offset < size:
        if offset + RECORD_HEAD.size > size:
            raise LogDamaged(f"{size - offset} bytes are left behind the last record")
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        frame = Frame(opcode, offset + RECORD_HEAD.size, length)
        offset = frame.end
        if offset > size:
            raise LogDamaged(f"a record of {length} bytes goes {offset - size} bytes beyond its chunk")
        yield frame
