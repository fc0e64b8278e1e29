"""Small logs that become large when they are read."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from robbie_mp.messages import PoseStamped, schema_text

MAGIC = b"\x89MCAP0\r\n"
MEGABYTE = 1 << 20
GIGABYTE = 1 << 30


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def schema_record(number: int, name: bytes, data: bytes) -> bytes:
    return record(Opcode.SCHEMA, struct.pack("<H", number) + text(name) + text(b"ros2msg") + text(data))


def channel_record(number: int, schema: int, topic: bytes) -> bytes:
    content = struct.pack("<HH", number, schema) + text(topic) + text(b"cdr") + text(b"")
    return record(Opcode.CHANNEL, content)


def message_record(channel: int, data: bytes) -> bytes:
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", channel, 1, 1, 1) + data)


def chunk_record(packed: bytes, size: int, compression: bytes = b"zstd", checksum: int = 0) -> bytes:
    head = struct.pack("<QQQI", 1, 1, size, checksum) + text(compression)
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(packed)) + packed)


def log_of(path: Path, *records: bytes) -> Path:
    """Write a log without a summary, as one that was cut, so that all of it is read."""
    kind = PoseStamped.type_name.encode()
    described = schema_record(1, kind, schema_text(PoseStamped).encode()) + channel_record(1, 1, b"/pose")
    path.write_bytes(MAGIC + record(Opcode.HEADER, text(b"") + text(b"")) + described + b"".join(records))
    return path


def zeros(count: int, head: bytes = b"") -> Iterator[bytes]:
    """Yield a message record whose data are that many zeros."""
    yield struct.pack("<BQ", Opcode.MESSAGE, 22 + count) + struct.pack("<HIQQ", 1, 1, 1, 1)
    piece = bytes(MEGABYTE)
    for _ in range(count // MEGABYTE):
        yield piece


ZEROS_HEAD_BYTES = 31


def zstd_with_size(count: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=count + ZEROS_HEAD_BYTES)
    return b"".join(map(packer.compress, zeros(count))) + packer.flush()


def zstd_without_size(count: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    return b"".join(map(packer.compress, zeros(count))) + packer.flush()


def lz4_without_size(count: int) -> bytes:
    frame = lz4.frame.LZ4FrameCompressor()
    packed: bytes = frame.begin() + b"".join(map(frame.compress, zeros(count))) + frame.flush()
    return packed


PACKERS: dict[str, tuple[Callable[[int], bytes], bytes]] = {
    "zstd": (zstd_with_size, b"zstd"),
    "zstd without its size": (zstd_without_size, b"zstd"),
    "lz4": (lz4_without_size, b"lz4"),
}


def bomb(path: Path, packer: str, count: int = GIGABYTE) -> Path:
    """Write a log whose only chunk decompresses to this number of bytes."""
    pack, name = PACKERS[packer]
    return log_of(path, chunk_record(pack(count), count + ZEROS_HEAD_BYTES, name))
