"""Limits for reading logs: a file of a few kB can be made to expand into gigabytes."""

from dataclasses import dataclass

from robbie_mp.logs.recording.errors import LogLimitExceeded

MEGABYTE = 1 << 20


@dataclass(frozen=True)
class ReadLimits:
    """Limits for a log; reading beyond them raises `LogLimitExceeded`."""

    chunk_bytes: int = 256 * MEGABYTE
    """Size of a decompressed chunk, and of a record outside of any chunk. Our logger writes chunks of 1 MiB,
    or of one message if that is larger."""
    description_bytes: int = 16 * MEGABYTE
    """Size of all schemas and channels together."""
    channels: int = 10_000
    """Number of channels, and also of schemas."""

    def check_chunk(self, size: int) -> None:
        """Raise LogLimitExceeded if a chunk or a record is too large."""
        if size > self.chunk_bytes:
            raise LogLimitExceeded(
                f"a chunk or record of {size} bytes; the limit is {self.chunk_bytes} bytes. If you trust the "
                "log and have the memory, allow more (--max-chunk)"
            )

    def check_descriptions(self, channels: int, size: int) -> None:
        """Raise LogLimitExceeded if a log's channel or schema descriptions are too many or too long."""
        if channels > self.channels:
            raise LogLimitExceeded(f"more than {self.channels} channels or schemas, which is the limit")
        if size > self.description_bytes:
            raise LogLimitExceeded(
                f"schemas and channels of more than {self.description_bytes} bytes together, the limit"
            )


READ_LIMITS = ReadLimits()
