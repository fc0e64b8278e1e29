"""Writes one file of a log, chunk by chunk; a failed write leaves no trace in it.

This module does not use the library's `mcap.writer.Writer`: it copies each message four times, it counts
messages before they are written, and after a failed write it can neither take the chunk back nor finish the
file. It does use the library's record classes.
"""

import fcntl
import os
import zlib
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from robbie_mp.logs.recording.appended_file import AppendedFile
from robbie_mp.logs.recording.chunk import Chunk, Compression, compress
from robbie_mp.logs.recording.format import (
    CARRIED_KEY,
    LATCHED_KEY,
    MESSAGE_ENCODING,
    PROFILE,
    SCHEMA_ENCODING,
    ChannelKey,
    TopicNames,
)
from robbie_mp.logs.recording.mcap_records import MAGIC

CHUNK_HEAD = Struct("<BQQQQII")
"""Opcode, length, start time, end time, uncompressed size and checksum, length of the compression's name."""
FOOTER_HEAD = Struct("<BQQQ")
INDEX_HEAD = Struct("<BQHI")
Pieces = Sequence[bytes | bytearray]


@dataclass(frozen=True)
class RecordedChannel:
    """A channel of a recording; it has the same id in every part."""

    id: int
    key: ChannelKey
    schema: str | None
    """The ros2msg text of its type; '' if it is not known."""
    carried_id: int = 0
    """The channel for copies of its newest message at the beginning of a part; 0: it is not latched."""
    is_carried: bool = False
    """Whether it is such a channel."""

    def metadata(self) -> dict[str, str]:
        """Return the metadata of the channel in the log."""
        marks = {LATCHED_KEY: self.carried_id or self.is_carried, CARRIED_KEY: self.is_carried}
        return self.key.metadata() | {name: "1" for name, is_set in marks.items() if is_set}


class PartWriter:
    """An MCAP file that is being written, and locked (flock) meanwhile.

    Every method that writes raises OSError if it cannot write, after taking back what it wrote: the file then
    ends with its last whole chunk.

    Args:
        path: the path of the file, which must not exist yet.
        compression: compression of its chunks.
        library: name of the program that writes it.
    """

    def __init__(self, path: Path, compression: Compression, library: str):
        self.path = path
        self.is_finished = False
        self._compression = compression
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[tuple[str, str | None], Schema] = {}
        self._topics = TopicNames()
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._end_ns = 0
        self._first_ns = 0
        self._file = AppendedFile(path)
        try:
            fcntl.flock(self._file.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._file.append([MAGIC, _bytes_of(Header(profile=PROFILE, library=library))])
            _sync_folder(path.parent)
        except BaseException:
            self.close()
            path.unlink()
            raise

    @property
    def counts(self) -> dict[int, int]:
        """Number of messages of each channel, by channel id."""
        return self._counts

    def write(self, chunk: Chunk, channels: Mapping[int, RecordedChannel]) -> None:
        """Write a chunk, after the descriptions of its channels that the file lacks."""
        new = [channels[id_] for id_ in chunk.index if id_ not in self._channels]
        new_schemas, new_channels = self._describe(new)
        described = b"".join(_bytes_of(record) for record in (*new_schemas.values(), *new_channels))
        index, pieces = self._pack(chunk, described)
        self._file.append(pieces)
        self._schemas |= new_schemas
        self._channels |= {channel.id: channel for channel in new_channels}
        self._chunk_indexes.append(index)
        for id_, count in chunk.counts().items():
            self._counts[id_] = self._counts.get(id_, 0) + count
        self._first_ns = min(self._first_ns or chunk.start_ns, chunk.start_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)

    def _describe(
        self, channels: Sequence[RecordedChannel]
    ) -> tuple[dict[tuple[str, str | None], Schema], list[Channel]]:
        schemas: dict[tuple[str, str | None], Schema] = {}
        records = []
        for channel in channels:
            wanted = (channel.key.type_name, channel.schema)
            schema = self._schemas.get(wanted) or schemas.get(wanted)
            if schema is None:
                number = len(self._schemas) + len(schemas) + 1
                schema = schemas[wanted] = Schema(
                    id=number,
                    name=wanted[0],
                    encoding="" if wanted[1] is None else SCHEMA_ENCODING,  # "": there is none
                    data=(wanted[1] or "").encode(),
                )
            records.append(
                Channel(
                    id=channel.id,
                    topic=self._topics.of(channel.key),
                    message_encoding=MESSAGE_ENCODING,
                    schema_id=schema.id,
                    metadata=channel.metadata(),
                )
            )
        return schemas, records

    def _pack(self, chunk: Chunk, described: bytes) -> tuple[ChunkIndex, Pieces]:
        """Return a chunk's record and its message index records, and its index for the summary."""
        size = len(described) + len(chunk.data)
        checksum = zlib.crc32(chunk.data, zlib.crc32(described))
        packed = compress([described, chunk.data], self._compression)
        name = self._compression.mcap_name.encode()
        packed_bytes = sum(map(len, packed))
        length = CHUNK_HEAD.size - 9 + len(name) + 8 + packed_bytes
        head = CHUNK_HEAD.pack(
            Opcode.CHUNK, length, chunk.start_ns, chunk.end_ns, size, checksum, len(name)
        )  # fmt: skip
        head += name + packed_bytes.to_bytes(8, "little")
        at = self.bytes + length + 9
        indexes, offsets = [], {}
        for id_, entries in chunk.index.items():
            offsets[id_] = at
            indexes.append(_message_index(id_, entries, len(described)))
            at += len(indexes[-1])
        index = ChunkIndex(
            message_start_time=chunk.start_ns,
            message_end_time=chunk.end_ns,
            chunk_start_offset=self.bytes,
            chunk_length=length + 9,
            message_index_offsets=offsets,
            message_index_length=sum(map(len, indexes)),
            compression=name.decode(),
            compressed_size=packed_bytes,
            uncompressed_size=size,
        )
        return index, [head, *packed, *indexes]

    def add_metadata(self, name: str, metadata: dict[str, str]) -> None:
        """Write a metadata record."""
        record = _bytes_of(Metadata(name=name, metadata=metadata))
        at = self.bytes
        self._file.append([record])
        self._metadata_indexes.append(MetadataIndex(offset=at, length=len(record), name=name))

    def sync(self) -> None:
        """Force all written data to disk.

        Raises:
            OSError: the sync failed; it is then unknown what the disk has kept since the last sync.
        """
        os.fdatasync(self._file.fd)

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        data_end = _bytes_of(DataEnd(data_section_crc=0))
        start = self.bytes + len(data_end)
        channels = sorted(self._channels.values(), key=self._place)
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        ]
        summary = bytearray()
        offsets = bytearray()
        for opcode, records in groups:
            if records:
                group = b"".join(map(_bytes_of, records))
                offsets += _bytes_of(
                    SummaryOffset(
                        group_opcode=opcode, group_start=start + len(summary), group_length=len(group)
                    )
                )
                summary += group
        offsets_start = start + len(summary)
        summary += offsets
        footer_head = FOOTER_HEAD.pack(Opcode.FOOTER, 20, start, offsets_start)
        checksum = zlib.crc32(footer_head, zlib.crc32(summary))
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=checksum)
        self._file.append([data_end, summary, _bytes_of(footer), MAGIC])
        self.is_finished = True
        self.sync()

    def _place(self, channel: Channel) -> tuple[bool, int]:
        """Return where a channel stands in the summary: apps show the count of a topic's first channel."""
        return CARRIED_KEY in channel.metadata, -self._counts.get(channel.id, 0)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=self._end_ns,
            message_start_time=self._first_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )

    def close(self) -> None:
        """Close and unlock the file."""
        self._file.close()

    @property
    def bytes(self) -> int:
        """Size of the file."""
        return self._file.bytes


def _message_index(channel_id: int, entries: "array[int]", shift: int) -> bytes:
    """Return the record with the positions of a channel's messages in a chunk, shifted by `shift` bytes."""
    shifted = array("Q", entries)
    for at in range(1, len(shifted), 2):
        shifted[at] += shift
    size = shifted.itemsize * len(shifted)
    return INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, size + 6, channel_id, size) + shifted.tobytes()


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _sync_folder(folder: Path) -> None:
    """Force the names in a folder to disk."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
