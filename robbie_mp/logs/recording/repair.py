"""Makes a complete log from a truncated or damaged one, and verifies it by reading it again."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from robbie_mp.logs.recording.contents import Contents
from robbie_mp.logs.recording.conversion import new_log_file
from robbie_mp.logs.recording.errors import LogIncomplete, RepairFailed
from robbie_mp.logs.recording.limits import READ_LIMITS, ReadLimits
from robbie_mp.logs.recording.part import LogPart
from robbie_mp.logs.recording.reader import REPAIRED_SUFFIX

COMPRESSIONS = {"": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
REPAIR_METADATA = "robbie_repair"
"""Name of the metadata record that describes a repair."""


@dataclass(frozen=True)
class Repair:
    """The result of a repair.

    Attributes:
        target: the new file.
        messages: number of messages in it.
        damage: the damage in the old file; empty if there was none.
    """

    target: Path
    messages: int
    damage: list[str]


Progress = Callable[[int, int], None]
"""Called with the amount done and the total."""


def unwatched(_done: int, _total: int) -> None:
    """Show no progress."""


def repaired_name(source: Path) -> Path:
    """Return the default path of the repaired log, at which `open_log` of its folder finds it."""
    return source.with_name(source.name.removesuffix(".mcap") + REPAIRED_SUFFIX)


def repair(source: Path, target: Path, progress: Progress, limits: ReadLimits = READ_LIMITS) -> Repair:
    """Write a file with every message of every whole chunk of another, and check it by reading it again.

    Args:
        source: the log: one MCAP file, written by any program. It is only read.
        target: the new file. If the repair fails, it is removed.
        progress: counts messages, each once when it is written and once when it is read again.
        limits: limits for the contents of the source.

    Raises:
        LogUnreadable, NotALog: as for `open_log`.
        LogLimitExceeded: something in the source is too large.
        LogIncomplete: the source is still being written.
        LogNotWritten: the target exists, or cannot be written.
        RepairFailed: reading the file again did not yield what was written.
    """
    with LogPart(source, limits, trust_summary=False) as part:
        if part.is_being_written:
            raise LogIncomplete(f"{source} is still being written; repair it when the recording has ended")
        with new_log_file(target) as file:
            return _write_and_check(part, file, target, progress)


def _write_and_check(part: LogPart, file: BinaryIO, target: Path, progress: Progress) -> Repair:
    total = 2 * part.contents.message_count
    written = _Digest(lambda count: progress(count, total))
    _write(part, file, written)
    file.flush()
    os.fsync(file.fileno())
    file.seek(0)
    found = _Digest(lambda count: progress(written.count + count, total))
    try:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False):
            found.add(channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
    except (McapError, ValueError, LookupError) as error:
        raise RepairFailed(f"{target} was written, but cannot be read: {error!r}; it was removed") from error
    if found.state() != written.state():
        raise RepairFailed(f"{target} does not contain the written data; it was removed. Check the disk")
    return Repair(target, found.count, list(part.contents.damage))


class _Digest:
    """Counts and hashes messages, in order to compare two sequences of them."""

    def __init__(self, progress: Callable[[int], None]):
        self.count = 0
        self._progress = progress
        self._hash = hashlib.blake2b()

    def add(self, topic: str, sequence: int, time_ns: int, publish_time_ns: int, data: bytes) -> None:
        """Add a message."""
        self.count += 1
        self._hash.update(f"{topic}\n{sequence} {time_ns} {publish_time_ns} {len(data)}\n".encode())
        self._hash.update(data)
        self._progress(self.count)

    def state(self) -> tuple[int, bytes]:
        """Return the count and the hash, which are equal only for equal sequences."""
        return self.count, self._hash.digest()


def _write(part: LogPart, file: BinaryIO, digest: _Digest) -> None:
    contents = part.contents
    writer = Writer(file, compression=_compression(contents))
    writer.start(contents.header.profile, contents.header.library)
    for record in contents.metadata:
        writer.add_metadata(record.name, record.metadata)
    if contents.damage:
        about = {"source": part.path.name, "damage": "\n".join(contents.damage)}
        writer.add_metadata(REPAIR_METADATA, about)
    for attachment in part.attachments():
        writer.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )
    schema_ids = {0: 0} | {
        id_: writer.register_schema(schema.name, schema.encoding, schema.data)
        for id_, schema in sorted(contents.schemas.items())
    }
    channel_ids = {
        id_: writer.register_channel(
            channel.topic, channel.message_encoding, schema_ids.get(channel.schema_id, 0), channel.metadata
        )
        for id_, channel in sorted(contents.channels.items())
    }
    for message in part.messages(channel_ids=contents.channels):
        _, sequence, time_ns, publish_time_ns, data = message
        writer.add_message(channel_ids[message.channel_id], time_ns, data, publish_time_ns, sequence)
        digest.add(contents.channels[message.channel_id].topic, *message[1:])
    writer.finish()  # type: ignore[no-untyped-call]


def _compression(contents: Contents) -> CompressionType:
    """Return the compression of most chunks."""
    counts = contents.compressions or {"": 1}
    return COMPRESSIONS[max(counts, key=counts.__getitem__)]
