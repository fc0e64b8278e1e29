"""The contents of a log file and their positions, from its summary or from reading the whole file."""

from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema

from robbie_mp.logs.recording.limits import ReadLimits
from robbie_mp.logs.recording.mcap_records import Frame, chunk_data, content, parse


class MessageBlock(NamedTuple):
    """Messages that lie together: those of a chunk, or of consecutive records outside of any chunk."""

    frame: Frame
    """The chunk's frame; for consecutive records its opcode is MESSAGE, and its content is whole records."""
    start_ns: int
    """Log time of the earliest message."""
    end_ns: int
    """Log time of the latest message."""
    channel_ids: frozenset[int] | None
    """Ids of the channels with messages in it; None if they are not known."""

    def read(self, file: BinaryIO, limits: ReadLimits) -> bytes:
        """Return the records of the block.

        Raises:
            LogDamaged: the records are not what was written.
            LogLimitExceeded: the records are too large.
        """
        data = content(file, self.frame, limits)
        return chunk_data(parse(Chunk, data), limits) if self.frame.opcode == Opcode.CHUNK else data


@dataclass
class Contents:
    """The contents of a log file and their positions.

    Attributes:
        header: the profile and library that wrote it.
        schemas: by their ids.
        channels: by their ids.
        blocks: positions of the messages, in file order.
        counts: messages of each channel, by its id.
        metadata: in file order.
        attachments: positions of the attachments.
        start_ns: log time of the earliest message; 0 if there is none.
        end_ns: log time of the latest message; 0 if there is none.
        compressions: number of chunks by compression ("" for none).
        strangers: messages of channels that are not described, if the whole file was read.
        damage: descriptions of the damage; empty for a file that was written to its end.
    """

    header: Header = field(default_factory=lambda: Header(profile="", library=""))
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    blocks: list[MessageBlock] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[Frame] = field(default_factory=list)
    start_ns: int = 0
    end_ns: int = 0
    compressions: dict[str, int] = field(default_factory=dict)
    strangers: int = 0
    damage: list[str] = field(default_factory=list)
    _description_bytes: int = 0

    def add_schema(self, schema: Schema, limits: ReadLimits) -> None:
        """Add the description of a type.

        Raises:
            LogLimitExceeded: there are too many schemas, or they are too long.
        """
        self._add_bytes(self.schemas.get(schema.id), schema)
        self.schemas[schema.id] = schema
        limits.check_descriptions(len(self.schemas), self._description_bytes)

    def add_channel(self, channel: Channel, limits: ReadLimits) -> None:
        """Add the description of a channel.

        Raises:
            LogLimitExceeded: there are too many channels, or they are too long.
        """
        self._add_bytes(self.channels.get(channel.id), channel)
        self.channels[channel.id] = channel
        limits.check_descriptions(len(self.channels), self._description_bytes)

    def _add_bytes(self, before: Schema | Channel | None, now: Schema | Channel) -> None:
        self._description_bytes += _length(now) - (_length(before) if before is not None else 0)

    @property
    def message_count(self) -> int:
        """Number of messages in the whole file."""
        return sum(self.counts.values())


def _length(described: Schema | Channel) -> int:
    """Return the approximate size of a description in bytes."""
    if isinstance(described, Schema):
        return len(described.name) + len(described.data)
    texts = sum(len(key) + len(value) for key, value in described.metadata.items())
    return len(described.topic) + len(described.message_encoding) + texts
