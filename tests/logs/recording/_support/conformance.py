"""The files of MCAP's conformance suite, made here from its published rules.

Each of six inputs is written with every set of features that makes sense for it: 416 files. They are the
published ones, byte by byte: `PUBLISHED` is made of the SHA-256 of each.

Source: https://github.com/foxglove/mcap, tests/conformance (README.md and data/*/*.json).
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from robbie_mp.logs.recording.mcap_records import MAGIC

FEATURES = ("ax", "ch", "chx", "mdx", "mx", "pad", "rch", "rsh", "st", "sum")
"""Indexes of attachments, chunks, chunk indexes, indexes of metadata, message indexes, more bytes at the end
of records, repeated channels, repeated schemas, statistics, summary offsets."""
PADDING = b"\x01\xff\xff"
NEVER_PADDED = (Message, DataEnd, Footer)
SCHEMA = Schema(id=1, name="Example", encoding="c", data=b"\4\5\6")
CHANNEL = Channel(id=1, topic="example", schema_id=1, message_encoding="a", metadata={"foo": "bar"})
BARE_CHANNEL = Channel(id=1, topic="example", schema_id=0, message_encoding="text", metadata={})
MESSAGE = Message(channel_id=1, log_time=2, publish_time=1, sequence=10, data=b"\1\2\3")
ATTACHMENT = Attachment(
    create_time=1, log_time=2, name="myFile", media_type="application/octet-stream", data=b"\1\2\3"
)
TEN_MESSAGES = tuple(
    Message(channel_id=1, log_time=time, publish_time=time, sequence=number, data=b"\1\2\3")
    for number, time in enumerate((0, 2, 1, 3, 3, 5, 4, 7, 8, 9))
)
INPUTS: dict[str, tuple[McapRecord, ...]] = {
    "NoData": (),
    "OneSchemalessMessage": (BARE_CHANNEL, MESSAGE),
    "OneMessage": (SCHEMA, CHANNEL, MESSAGE),
    "OneAttachment": (ATTACHMENT,),
    "OneMetadata": (Metadata(name="myMetadata", metadata={"foo": "bar"}),),
    "TenMessages": (SCHEMA, CHANNEL, *TEN_MESSAGES),
}
NEEDS = {"ax": Attachment, "mdx": Metadata, "rsh": Schema, "rch": Channel}


PUBLISHED = "bb5070df8fbb1b12cc0013ca4e88858c2873829f1cf6e9b765773d55d391c1fd"
"""SHA-256 of the hexadecimal SHA-256 of all files, in the order of their names."""


class Variant(NamedTuple):
    """A file of the suite."""

    input: str
    features: frozenset[str]

    @property
    def name(self) -> str:
        """Its name there."""
        return "-".join((self.input, *sorted(self.features)))

    @property
    def records(self) -> tuple[McapRecord, ...]:
        """The schemas, channels, messages, attachments and metadata in it."""
        return INPUTS[self.input]


def variants() -> Iterator[Variant]:
    """Yield all files of the suite."""
    for name, records in INPUTS.items():
        for count in range(len(FEATURES) + 1):
            for features in map(frozenset, combinations(FEATURES, count)):
                if _makes_sense(records, features):
                    yield Variant(name, features)


def _makes_sense(records: Sequence[McapRecord], has: frozenset[str]) -> bool:
    kinds = {type(record) for record in records}
    return (
        all(kind in kinds for feature, kind in NEEDS.items() if feature in has)
        and not (has & {"ch", "chx", "mx"} and Channel not in kinds)
        and not (has & {"chx", "mx"} and "ch" not in has)
        and not ("sum" in has and not has & {"ax", "chx", "mdx", "rch", "rsh", "st"})
    )


def encoded(record: McapRecord, padding: bytes = b"") -> bytes:
    """Return a record as it is in a file, with more bytes at its end if such a record may have them."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    if isinstance(record, NEVER_PADDED):
        return data
    return data[:1] + struct.pack("<Q", len(data) - 9 + len(padding)) + data[9:] + padding


class _File:
    """A file while it is written."""

    def __init__(self, features: frozenset[str], padding: bytes, padding_in_chunks: bytes):
        self.has = features
        self.padding = padding if "pad" in features else b""
        self.padding_in_chunks = padding_in_chunks
        self.data = MAGIC + encoded(Header(profile="", library=""), self.padding)
        self.indexes: list[McapRecord] = []

    def add(self, record: McapRecord) -> tuple[int, int]:
        """Write a record; return where it begins, and its length."""
        start = len(self.data)
        self.data += encoded(record, self.padding)
        return start, len(self.data) - start

    def add_single(self, record: McapRecord) -> None:
        """Write a record outside of chunks, and keep its index if the file has such indexes."""
        offset, length = self.add(record)
        if isinstance(record, Attachment) and "ax" in self.has:
            self.indexes.append(
                AttachmentIndex(
                    offset=offset,
                    length=length,
                    log_time=record.log_time,
                    create_time=record.create_time,
                    data_size=len(record.data),
                    name=record.name,
                    media_type=record.media_type,
                )
            )
        if isinstance(record, Metadata) and "mdx" in self.has:
            self.indexes.append(MetadataIndex(offset=offset, length=length, name=record.name))

    def add_chunk(self, records: Sequence[McapRecord]) -> None:
        """Write all records in one chunk, with its indexes."""
        data = b""
        entries: dict[int, list[tuple[int, int]]] = {
            one.id: [] for one in records if isinstance(one, Channel)
        }
        for record in records:
            if isinstance(record, Message):
                entries[record.channel_id].append((record.log_time, len(data)))
            data += encoded(record, self.padding_in_chunks)
        start_ns, end_ns = _span(records)
        chunk = Chunk(
            compression="",
            data=data,
            message_start_time=start_ns,
            message_end_time=end_ns,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        padding, self.padding = self.padding, self.padding_in_chunks  # the suite never pads its chunks
        offset, length = self.add(chunk)
        self.padding = padding
        found = {id_: self.add(MessageIndex(id_, rows)) for id_, rows in entries.items() if "mx" in self.has}
        if "chx" in self.has:
            self.indexes.append(
                ChunkIndex(
                    chunk_length=length,
                    chunk_start_offset=offset,
                    compression="",
                    compressed_size=len(data),
                    message_end_time=end_ns,
                    message_index_length=sum(each for _, each in found.values()),
                    message_index_offsets={id_: at for id_, (at, _) in found.items()},
                    message_start_time=start_ns,
                    uncompressed_size=len(data),
                )
            )

    def add_summary(self, records: Sequence[McapRecord]) -> tuple[int, int]:
        """Write the summary; return where it begins, and where its offsets begin; 0 for nothing."""
        repeated = {"rsh": Schema, "rch": Channel}
        groups = [
            [one for one in records if isinstance(one, kind)]
            for feature, kind in repeated.items()
            if feature in self.has
        ]
        groups += [[_statistics(records, self.has)]] if "st" in self.has else []
        groups += [self.indexes]
        start, offsets = len(self.data), []
        for group in filter(None, groups):
            places = [self.add(record) for record in group]
            length = sum(each for _, each in places)
            opcode = self.data[places[0][0]]
            offsets.append(SummaryOffset(group_opcode=opcode, group_start=places[0][0], group_length=length))
        end = len(self.data)
        if "sum" in self.has:
            for offset in offsets:
                self.add(offset)
        return (start if len(self.data) > start else 0), (end if "sum" in self.has else 0)


def written(variant: Variant, padding: bytes = PADDING, padding_in_chunks: bytes = b"") -> bytes:
    """Return a file of the suite.

    Args:
        variant: which.
        padding: the bytes at the end of records, if it has the feature `pad`.
        padding_in_chunks: likewise of records in chunks and of the chunks, which the suite does not pad.
    """
    file = _File(variant.features, padding, padding_in_chunks)
    if "ch" in variant.features:
        file.add_chunk(variant.records)
    else:
        for record in variant.records:
            file.add_single(record)
    file.add(DataEnd(data_section_crc=zlib.crc32(file.data)))
    data_end = len(file.data)
    start, offsets = file.add_summary(variant.records)
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets)
    crc = zlib.crc32(head, zlib.crc32(file.data[data_end:]))
    file.add(Footer(summary_start=start, summary_offset_start=offsets, summary_crc=crc))
    return file.data + MAGIC


def _span(records: Sequence[McapRecord]) -> tuple[int, int]:
    times = [one.log_time for one in records if isinstance(one, Message)]
    return min(times, default=0), max(times, default=0)


def _statistics(records: Sequence[McapRecord], has: frozenset[str]) -> Statistics:
    start_ns, end_ns = _span(records)
    count = [type(record) for record in records].count
    return Statistics(
        attachment_count=count(Attachment),
        channel_count=count(Channel),
        channel_message_counts={1: count(Message)} if count(Message) else {},
        chunk_count=int("ch" in has),
        message_count=count(Message),
        message_end_time=end_ns,
        message_start_time=start_ns,
        metadata_count=count(Metadata),
        schema_count=count(Schema),
    )
