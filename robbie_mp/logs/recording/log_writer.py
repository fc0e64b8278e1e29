"""Writes a recording: one part after another, within a disk budget, with a count of missing messages."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from robbie_mp.base.linux.private_files import make_private_folder
from robbie_mp.logs.recording.bag_metadata import write_bag_metadata
from robbie_mp.logs.recording.chunk import Chunk, Compression
from robbie_mp.logs.recording.disk_budget import LIBRARY, DiskBudget
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.logs.recording.format import (
    COUNTS_METADATA,
    PART_NAME,
    RUN_METADATA,
    ChannelKey,
    RecordedCount,
    RunMetadata,
    counts_metadata,
    part_path,
)
from robbie_mp.logs.recording.newest import KeepLimits, NewestMessages
from robbie_mp.logs.recording.part_writer import PartWriter, RecordedChannel


@dataclass(frozen=True)
class Split:
    """When a part ends and the next one starts."""

    bytes: int = 0
    """End a part at this size; 0: never."""
    seconds: float = 0.0
    """End a part this long after its first message; 0: never."""


class LogWriter:
    """Writes the parts of one recording. Use it from one thread only.

    It adds parts to a recording that exists already. Every method that writes raises OSError if it cannot
    write. It then ends the part as well as it can, and the next chunk starts another one.

    Args:
        folder: the folder of the recording, which is created.
        compression: compression of the chunks.
        run: metadata for the parts; part, first sequence and start are filled in.
        split: when a part ends.
        budget: disk space for this recording and those beside it.
        dropped: returns the number of missing messages by channel, since the recording started.
        on_end: called with the number and the counts of each part that has ended.
        keep: limits for the newest messages of latched channels, of which each part begins with a copy.

    Attributes:
        newest: these messages.

    Raises:
        OSError: the folder cannot be created.
    """

    def __init__(
        self,
        folder: Path,
        compression: Compression,
        run: RunMetadata,
        split: Split,
        budget: DiskBudget,
        dropped: Callable[[], Mapping[ChannelKey, int]],
        on_end: Callable[[int, Mapping[ChannelKey, RecordedCount]], None] = lambda _number, _counts: None,
        keep: KeepLimits = KeepLimits(),  # noqa: B008 - it is frozen
    ):
        self.folder = folder
        self.newest = NewestMessages(keep)
        self.bytes = 0
        """Bytes written so far, in all parts."""
        self.parts = 0
        self.removed = 0
        """Old parts that were removed."""
        self._compression = compression
        self._run = run
        self._split = split
        self._budget = budget
        self._dropped = dropped
        self._on_end = on_end
        self._dropped_before: Mapping[ChannelKey, int] = {}
        """Bytes in finished parts."""
        self._dropped_told: Mapping[ChannelKey, int] = {}
        self._part: PartWriter | None = None
        self._copied_bytes = 0
        """Size of the copies at the beginning of this part; they do not bring the next part any nearer."""
        self._channels: Mapping[int, RecordedChannel] = {}
        self._start_ns = 0
        make_private_folder(folder)
        numbers = (PART_NAME.fullmatch(path.name) for path in folder.iterdir())
        self._next_number = 1 + max((int(match["number"]) for match in numbers if match), default=-1)

    def write(self, chunk: Chunk, channels: Mapping[int, RecordedChannel]) -> None:
        """Write a chunk.

        Args:
            chunk: its messages.
            channels: the channels of the recording, by id.
        """
        self._channels = channels
        if self._part is not None and self._is_full(self._part, chunk):
            self.end_part()
        part = self._part
        if part is None:
            part = self._part = self._begin(chunk)
            begun_bytes = part.bytes
            for copies in self.newest.copies(chunk.start_ns, before=chunk.first_sequence):
                self._write(part, copies)
            self._copied_bytes = part.bytes - begun_bytes
        self._write(part, chunk)
        self.newest.keep_from(chunk, channels)

    def write_newest(self, channels: Mapping[int, RecordedChannel]) -> None:
        """Write the newest messages of latched channels as a part, if nothing else has been written."""
        newest_ns = self.newest.newest_ns
        if self.parts or newest_ns is None:
            return
        self._channels = channels
        for copies in self.newest.copies(newest_ns):
            if self._part is None:
                self._part = self._begin(copies)
            self._write(self._part, copies)

    def _write(self, part: PartWriter, chunk: Chunk) -> None:
        self.removed += len(self._budget.make_room(part.bytes + len(chunk.data)))
        before = part.bytes
        try:
            part.write(chunk, self._channels)
        except OSError:
            self._give_up(part)
            raise
        self.bytes += part.bytes - before

    def _is_full(self, part: PartWriter, chunk: Chunk) -> bool:
        split = self._split
        return (0 < split.bytes <= part.bytes - self._copied_bytes + len(chunk.data)) or (
            0 < split.seconds * 1e9 <= chunk.end_ns - self._start_ns
        )

    def _begin(self, chunk: Chunk) -> PartWriter:
        number = self._next_number
        path = part_path(self.folder, number)
        self._budget.look(path)
        self.removed += len(self._budget.make_room(len(chunk.data)))
        part = PartWriter(path, self._compression, f"{LIBRARY} {self._run.version}")
        run = replace(self._run, part=number, first_sequence=chunk.first_sequence, started_ns=chunk.start_ns)
        try:
            part.add_metadata(RUN_METADATA, run.as_metadata())
        except OSError:
            part.close()
            path.unlink()
            raise
        self._next_number = number + 1
        self._start_ns = chunk.start_ns
        self.parts += 1
        return part

    def sync(self) -> None:
        """Force all written data to disk, and the counts of missing messages."""
        part = self._part
        if part is None:
            return
        try:
            if self._dropped() != self._dropped_told:
                self._tell_counts(part)
            part.sync()
        except OSError:
            self._give_up(part)
            raise

    def end_part(self) -> None:
        """End the part that is being written; the next chunk starts another one."""
        part = self._part
        if part is None:
            return
        try:
            self._tell_counts(part)
            part.finish()
        except OSError:
            self._give_up(part)
            raise
        self._forget(part)

    def _give_up(self, part: PartWriter) -> None:
        """End a part after its last whole chunk; leave out the summary if there is no room for it."""
        if not part.is_finished:
            with contextlib.suppress(OSError):
                self._tell_counts(part)
                part.finish()
        self._forget(part)

    def _forget(self, part: PartWriter) -> None:
        part.close()
        self._on_end(self._next_number - 1, self._counts(part, self._dropped_told))
        self._dropped_before = self._dropped_told
        self._part = None

    def _tell_counts(self, part: PartWriter) -> None:
        dropped = dict(self._dropped())
        part.add_metadata(COUNTS_METADATA, counts_metadata(self._counts(part, dropped).items()))
        self._dropped_told = dropped

    def _counts(self, part: PartWriter, dropped: Mapping[ChannelKey, int]) -> dict[ChannelKey, RecordedCount]:
        """Return the counts of a part, given all messages that were missing at its end."""
        counts: dict[ChannelKey, RecordedCount] = {}
        for id_, count in part.counts.items():
            if not self._channels[id_].is_carried:
                counts.setdefault(self._channels[id_].key, RecordedCount()).recorded += count
        for key, total in dropped.items():
            new = total - self._dropped_before.get(key, 0)
            if new > 0 or key in counts:
                counts.setdefault(key, RecordedCount()).dropped = max(0, new)
        return counts

    def close(self) -> None:
        """End the recording, and describe it for rosbag2; one without any message leaves no folder."""
        try:
            self.end_part()
        finally:
            with contextlib.suppress(OSError):
                self.folder.rmdir()
        if self.parts and self.folder.exists():
            with contextlib.suppress(LogError):  # the folder has been changed by another program
                write_bag_metadata(self.folder)
