"""Makes a new log of parts of others: cuts out a time, selects channels, merges several logs.

Messages are copied one by one, as they are, so that memory does not grow with the log. The new log has the
metadata and attachments of the old ones, and its own counts. It begins with copies of what was newest
before on latched topics and `tf_static`; their channels are marked, and they are not counted as messages.
"""

import heapq
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import Channel, Schema
from mcap.writer import Writer

from robbie_mp.logs.recording.conversion import new_log_file
from robbie_mp.logs.recording.errors import LogNotWritten
from robbie_mp.logs.recording.format import (
    CARRIED_KEY,
    COUNTS_METADATA,
    LATCHED_KEY,
    RUN_METADATA,
    ChannelKey,
    RecordedCount,
    RunMetadata,
    counts_metadata,
)
from robbie_mp.logs.recording.info import last_counts
from robbie_mp.logs.recording.part import LogPart, PartMessage
from robbie_mp.logs.recording.reader import Log, LogChannel
from robbie_mp.logs.recording.repair import COMPRESSIONS, Progress

LIBRARY = "robbie edit"
"""Not the library name of recordings: a recording may be removed to make room when the disk is full."""
EDIT_METADATA = "robbie_edit"
"""Name of the metadata record that says how a log was made of others."""


@dataclass(frozen=True)
class Cut:
    """The messages of a log that go into the new one.

    Attributes:
        start_ns: leave out messages published before this time; None: none.
        end_ns: leave out messages published at this time or later; None: none.
        wants: whether the messages of a channel are copied.
    """

    start_ns: int | None = None
    end_ns: int | None = None
    wants: Callable[[LogChannel], bool] = field(default=lambda _channel: True)


@dataclass
class Edit:
    """The result.

    Attributes:
        target: the new file.
        messages: number of messages in it.
        carried: number of copies of older messages at its beginning.
        notes: what you should know about it, such as topics with several types.
    """

    target: Path
    messages: int
    carried: int
    notes: list[str]


class _Source(NamedTuple):
    """One file of a log, and which of its channels are copied."""

    log: Log
    part: LogPart
    channels: dict[int, LogChannel]
    """The channels that are copied, by their ids in the file."""


class _Entry(NamedTuple):
    """A message to write."""

    log: Log
    part: LogPart
    channel: LogChannel
    record: Channel
    """The description of its channel in that part."""
    message: PartMessage
    is_carried: bool = False
    """Whether it is a copy of an older message."""


def edit(
    logs: Sequence[Log], target: Path, operation: str, progress: Progress, cut: Cut | None = None
) -> Edit:
    """Write a new log with the selected messages of others, in the order of their times.

    Messages of one log keep their order. Those of several logs are merged by log time: each next message is
    the earliest of the next ones of all logs. Channels that are described alike become one; others, such as
    two definitions of a type, stay apart.

    Args:
        logs: the logs; they are only read.
        target: the new file. If writing fails, it is removed.
        operation: what is done, for the new log's metadata.
        progress: counts the messages that are read.
        cut: what is copied; by default everything.

    Raises:
        LogNotWritten: the target exists, lies in the folder of a source, or cannot be written.
        LogLimitExceeded: something in a source is too large.
    """
    for log in logs:
        if log.path.is_dir() and target.absolute().parent == log.path.absolute():
            raise LogNotWritten(f"{target} would become a part of {log.path}; choose another folder")
    with new_log_file(target) as file:
        made = _Editor(logs, file, cut or Cut(), progress)
        notes = made.write(operation)
        file.flush()
        os.fsync(file.fileno())
    return Edit(target, made.messages, made.carried, notes)


class _Editor:
    """Writes the new log."""

    def __init__(self, logs: Sequence[Log], file: BinaryIO, cut: Cut, progress: Progress):
        self.messages = 0
        self.carried = 0
        self._logs = logs
        self._cut = cut
        self._progress = progress
        self._sources = [
            [
                _Source(log, part, {id_: one for id_, one in channels.items() if cut.wants(one)})
                for part, channels in log.files()
            ]
            for log in logs
        ]
        contents = [source.part.contents for sources in self._sources for source in sources]
        used = [name for one in contents for name, count in one.compressions.items() for _ in range(count)]
        most_used = max(set(used), key=used.count) if used else ""
        self._writer = Writer(file, compression=COMPRESSIONS[most_used])
        self._profile = contents[0].header.profile if contents else ""
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[tuple[object, ...], int] = {}
        self._types_of: dict[str, set[tuple[str, bytes]]] = {}
        """For each topic as written, the types and definitions on it."""
        self._counts: dict[ChannelKey, RecordedCount] = {}
        self._first_of: list[_Entry | None] = []
        """The first message that is copied of each log."""

    def write(self, operation: str) -> list[str]:
        """Write the whole log. Return notes about it."""
        writer, total = self._writer, sum(log.message_count for log in self._logs)
        messages = (
            self._messages(log, sources) for log, sources in zip(self._logs, self._sources, strict=True)
        )
        merged = heapq.merge(*messages, key=lambda entry: entry.message.time_ns)
        first = next(merged, None)
        writer.start(self._profile, LIBRARY)
        self._write_metadata(operation)
        self._write_attachments()
        while first is not None:
            message = first.message
            writer.add_message(
                self._channel(first), message.time_ns, message.data, message.publish_time_ns, message.sequence
            )
            if first.is_carried:
                self.carried += 1
            else:
                self._counts.setdefault(first.channel.key, RecordedCount()).recorded += 1
                self.messages += 1
                self._progress(self.messages, total)
            first = next(merged, None)
        self._write_counts()
        writer.finish()  # type: ignore[no-untyped-call]
        return self._notes()

    def _messages(self, log: Log, sources: Sequence[_Source]) -> Iterator[_Entry]:
        """Yield the wanted messages of one log, after copies of what was newest before on latched topics."""
        messages = self._within_time(log, sources)
        first = next(messages, None)
        start_ns = log.start_ns if self._cut.start_ns is None else self._cut.start_ns
        time_ns = start_ns if first is None else first.message.time_ns
        self._first_of.append(first)
        wanted = [channel for channel in log.channels if self._cut.wants(channel)]
        for found in log.newest_latched(start_ns, wanted):
            part, record = log.record_of(found.channel)
            copy = PartMessage(record.id, found.sequence, time_ns, found.time_ns, found.data)
            yield _Entry(log, part, found.channel, record, copy, is_carried=True)
        if first is not None:
            yield first
        yield from messages

    def _within_time(self, log: Log, sources: Sequence[_Source]) -> Iterator[_Entry]:
        cut = self._cut
        for source in sources:
            for message in source.part.messages(cut.start_ns, cut.end_ns, source.channels):
                if (channel := source.channels.get(message.channel_id)) is not None:
                    record = source.part.contents.channels[message.channel_id]
                    yield _Entry(log, source.part, channel, record, message)

    def _write_metadata(self, operation: str) -> None:
        """Write each different record of the sources once; the counts are made again."""
        names = ", ".join(log.path.name for log in self._logs)
        self._writer.add_metadata(EDIT_METADATA, {"operation": operation, "sources": names})
        written: list[tuple[str, dict[str, str]]] = []
        filled = [entry for entry in self._first_of if entry is not None]
        first = min(filled, key=lambda entry: entry.message.time_ns, default=None)
        for log, sources in zip(self._logs, self._sources, strict=True):
            runs = [RunMetadata.from_metadata(record) for record in log.metadata(RUN_METADATA)]
            for run in {one.run_id: one for one in reversed(runs)}.values():
                new = replace(run, part=0)
                if first is not None and first.log is log:
                    started_ns = first.message.time_ns
                    new = replace(new, first_sequence=first.message.sequence, started_ns=started_ns)
                if (RUN_METADATA, {"run_id": run.run_id}) not in written:
                    self._writer.add_metadata(RUN_METADATA, new.as_metadata())
                    written.append((RUN_METADATA, {"run_id": run.run_id}))
            for source in sources:
                for record in source.part.contents.metadata:
                    entry = (record.name, record.metadata)
                    if record.name not in (RUN_METADATA, COUNTS_METADATA) and entry not in written:
                        self._writer.add_metadata(*entry)
                        written.append(entry)

    def _write_attachments(self) -> None:
        for sources in self._sources:
            for source in sources:
                for one in source.part.attachments():
                    self._writer.add_attachment(
                        one.create_time, one.log_time, one.name, one.media_type, one.data
                    )

    def _channel(self, entry: _Entry) -> int:
        """Return the new id of a message's channel; of channels that are described alike, the same."""
        channel, metadata = entry.record, dict(entry.record.metadata)
        if entry.is_carried:
            metadata |= {LATCHED_KEY: "1", CARRIED_KEY: "1"}
        schema = entry.part.contents.schemas.get(channel.schema_id)
        described = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
        key = (channel.topic, channel.message_encoding, tuple(sorted(metadata.items())), described)
        if key not in self._channels:
            self._types_of.setdefault(channel.topic, set()).add((described[0], described[2]))
            self._channels[key] = self._writer.register_channel(
                channel.topic, channel.message_encoding, self._schema(schema), metadata
            )
        return self._channels[key]

    def _schema(self, schema: Schema | None) -> int:
        if schema is None:
            return 0
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(*key)
        return self._schemas[key]

    def _write_counts(self) -> None:
        """Write the counts, if a source has some, with the messages that were missing around those copied."""
        counted = False
        for sources in self._sources:
            for source in sources:
                counts = last_counts(source.part)
                counted = counted or bool(counts)
                for key, count in counts.items() if self._is_used(source) else ():
                    if self._cut.wants(LogChannel(-1, *key, schema=None)) and count.dropped:
                        self._counts.setdefault(key, RecordedCount()).dropped += count.dropped
        if counted:
            self._writer.add_metadata(COUNTS_METADATA, counts_metadata(self._counts.items()))

    def _is_used(self, source: _Source) -> bool:
        """Whether the file covers any of the time that is copied."""
        contents, cut = source.part.contents, self._cut
        return (cut.start_ns is None or contents.end_ns >= cut.start_ns) and (
            cut.end_ns is None or contents.start_ns < cut.end_ns
        )

    def _notes(self) -> list[str]:
        """Say which topics have channels that differ in their types."""
        notes = []
        for topic, types in sorted(self._types_of.items()):
            names = sorted({name for name, _ in types})
            if len(types) > 1:
                kinds = "several types" if len(names) > 1 else f"{len(types)} definitions"
                notes.append(f"topic {topic} has {kinds}, each in its own channel: {', '.join(names)}")
        return notes
