"""The compressions of MCAP, applied to records that are in several pieces."""

from collections.abc import Sequence
from enum import StrEnum

import lz4.frame
import zstandard

ZSTD_LEVEL = 1
"""Compression level: a robot has little time for it."""


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
