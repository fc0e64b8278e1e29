"""Reads the summary of a log file, which describes the contents without reading the rest."""

import struct
import zlib
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Footer, Header, Metadata, MetadataIndex, Schema, Statistics

from robbie_mp.logs.recording.contents import Contents, MessageBlock
from robbie_mp.logs.recording.errors import LogDamaged
from robbie_mp.logs.recording.limits import ReadLimits
from robbie_mp.logs.recording.mcap_records import (
    MAGIC,
    RECORD_HEAD,
    Frame,
    content,
    frame_at,
    frames_in,
    parse,
)

FOOTER_BYTES = RECORD_HEAD.size + 20
CHUNK_INDEX_HEAD = struct.Struct("<QQQQI")
CHUNK_INDEX_ENTRY = struct.Struct("<HQ")
TEXT_LENGTH = struct.Struct("<QI")


def read_summary(file: BinaryIO, size: int, limits: ReadLimits) -> Contents | None:
    """Return the content of a file's summary; None if there is none, or if it is incomplete.

    Raises:
        LogDamaged: the file has no end, or its summary is damaged.
        LogLimitExceeded: the summary, or something that it describes, is too large.
    """
    start, data = _summary(file, size, limits)
    if not data:
        return None
    found = Contents(header=parse(Header, content(file, frame_at(file, len(MAGIC), size), limits)))
    statistics: Statistics | None = None
    metadata: list[MetadataIndex] = []
    for frame in frames_in(data):
        record = data[frame.start : frame.end]
        match frame.opcode:
            case Opcode.SCHEMA:
                found.add_schema(parse(Schema, record), limits)
            case Opcode.CHANNEL:
                found.add_channel(parse(Channel, record), limits)
            case Opcode.CHUNK_INDEX:
                found.blocks.append(_block(record, found.compressions, start))
            case Opcode.STATISTICS:
                statistics = parse(Statistics, record)
            case Opcode.METADATA_INDEX:
                metadata.append(parse(MetadataIndex, record))
            case Opcode.ATTACHMENT_INDEX:
                found.attachments.append(frame_at(file, parse(AttachmentIndex, record).offset, start))
    if statistics is None or not _says_all(found, statistics, len(metadata)):
        return None
    found.blocks.sort(key=lambda block: block.frame.start)
    found.counts = dict(statistics.channel_message_counts)
    found.start_ns, found.end_ns = statistics.message_start_time, statistics.message_end_time
    for index in sorted(metadata, key=lambda index: index.offset):
        found.metadata.append(parse(Metadata, content(file, frame_at(file, index.offset, start), limits)))
    return found


def _summary(file: BinaryIO, size: int, limits: ReadLimits) -> tuple[int, bytes]:
    """Return the position of the summary's records, and their bytes; b"" if there are none."""
    end = size - FOOTER_BYTES - len(MAGIC)
    file.seek(max(end, 0))
    tail = file.read(FOOTER_BYTES + len(MAGIC))
    opcode, length = RECORD_HEAD.unpack_from(tail.ljust(RECORD_HEAD.size, b"\0"))
    if end < len(MAGIC) or (opcode, length) != (Opcode.FOOTER, 20) or not tail.endswith(MAGIC):
        raise LogDamaged(f"the file has no end: it was cut at byte {size}")
    footer = parse(Footer, tail[RECORD_HEAD.size :])
    if footer.summary_start == 0:
        return end, b""
    if not len(MAGIC) < footer.summary_start <= end:
        raise LogDamaged(f"the summary cannot begin at byte {footer.summary_start}")
    data = content(file, Frame(Opcode.FOOTER, footer.summary_start, end - footer.summary_start), limits)
    if footer.summary_crc and zlib.crc32(data + tail[: FOOTER_BYTES - 4]) != footer.summary_crc:
        raise LogDamaged("the summary does not match its checksum")
    return footer.summary_start, data


def _says_all(found: Contents, statistics: Statistics, metadata_count: int) -> bool:
    """Whether the summary describes the whole file; writers may leave out any part of it."""
    return (
        len(found.blocks) == statistics.chunk_count
        and (found.blocks != [] or statistics.message_count == 0)
        and len(found.channels) == statistics.channel_count
        and metadata_count == statistics.metadata_count
        and len(found.attachments) == statistics.attachment_count
        and statistics.channel_message_counts.keys() <= found.channels.keys()
        and {channel.schema_id for channel in found.channels.values()} <= {0, *found.schemas}
    )


def _block(record: bytes, compressions: dict[str, int], limit: int) -> MessageBlock:
    """Read a ChunkIndex; the library takes 50 µs for one, and an hour's log has thousands."""
    try:
        start_ns, end_ns, offset, length, map_bytes = CHUNK_INDEX_HEAD.unpack_from(record)
        at = CHUNK_INDEX_HEAD.size + map_bytes
        ids = frozenset(id_ for id_, _ in CHUNK_INDEX_ENTRY.iter_unpack(record[CHUNK_INDEX_HEAD.size : at]))
        _, text_bytes = TEXT_LENGTH.unpack_from(record, at)
        text = record[at + TEXT_LENGTH.size :][:text_bytes].decode()
    except (struct.error, ValueError) as error:
        raise LogDamaged(f"the index of a chunk cannot be read: {error}") from error
    if length < RECORD_HEAD.size or offset + length > limit:
        raise LogDamaged(f"the index puts a chunk at byte {offset}, which is not in the file")
    compressions[text] = compressions.get(text, 0) + 1
    frame = Frame(Opcode.CHUNK, offset + RECORD_HEAD.size, length - RECORD_HEAD.size)
    return MessageBlock(frame, start_ns, end_ns, ids or None)
