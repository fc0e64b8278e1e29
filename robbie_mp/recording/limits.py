"""How much reading a log may take: a file of some kB can be made to unfold into gigabytes."""

from dataclasses import dataclass

from robbie_mp.recording.errors import LogLimitExceeded

MEGABYTE = 1 << 20


@dataclass(frozen=True)
class ReadLimits:
    """What is refused in a log, with `LogLimitExceeded`."""

    chunk_bytes: int = 256 * MEGABYTE
    """Of a chunk when it is decompressed, and of any record outside of a chunk. Our logger writes chunks of
    1 MiB, or of one message if that is larger."""
    description_bytes: int = 16 * MEGABYTE
    """Of all schemas and channels together."""
    channels: int = 10_000
    """And as many schemas."""

    def check_chunk(self, size: int) -> None:
        """Raise LogLimitExceeded if a chunk or a record is too large."""
        if size > self.chunk_bytes:
            raise LogLimitExceeded(
                f"a chunk or record of {size} bytes; the limit is {self.chunk_bytes} bytes. If you trust the "
                "log and have the memory, allow more (--max-chunk-mib)"
            )

    def check_descriptions(self, channels: int, size: int) -> None:
        """Raise LogLimitExceeded if a log describes too many channels or schemas, or at too great length."""
        if channels > self.channels:
            raise LogLimitExceeded(f"more than {self.channels} channels or schemas, which is the limit")
        if size > self.description_bytes:
            raise LogLimitExceeded(
                f"schemas and channels of more than {self.description_bytes} bytes together, the limit"
            )


READ_LIMITS = ReadLimits()
