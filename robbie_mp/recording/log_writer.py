"""Writes a recording: part after part, within a budget, and what is missing in it."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from robbie_mp.linux.private_files import make_private_folder
from robbie_mp.recording.chunk import Chunk
from robbie_mp.recording.compression import Compression
from robbie_mp.recording.disk_budget import LIBRARY, DiskBudget
from robbie_mp.recording.format import (
    COUNTS_METADATA,
    PART_NAME,
    RUN_METADATA,
    ChannelCount,
    ChannelKey,
    RunMetadata,
    counts_metadata,
    part_path,
)
from robbie_mp.recording.part_writer import PartWriter, RecordedChannel


@dataclass(frozen=True)
class Split:
    """When a part ends and the next one begins."""

    bytes: int = 0
    """With so many bytes; 0: never."""
    seconds: float = 0.0
    """So long after its first message; 0: never."""


class LogWriter:
    """Writes the parts of one recording. Belongs to one thread.

    A recording that is there already gets further parts. Every method that writes raises OSError if it
    cannot; the part is then ended as well as may be, and the next chunk begins another one.

    Args:
        folder: of the recording; it is made.
        compression: of the chunks.
        run: what the parts say of the run; part, first sequence and start are filled in.
        split: when a part ends.
        budget: room for this recording and others beside it.
        dropped: says how many messages of which channels are missing, since the recording began.

    Raises:
        OSError: the folder cannot be made.
    """

    def __init__(
        self,
        folder: Path,
        compression: Compression,
        run: RunMetadata,
        split: Split,
        budget: DiskBudget,
        dropped: Callable[[], Mapping[ChannelKey, int]],
    ):
        self.folder = folder
        self.bytes = 0
        """Written so far, of all parts."""
        self.parts = 0
        self.removed = 0
        """Old parts that had to go."""
        self._compression = compression
        self._run = run
        self._split = split
        self._budget = budget
        self._dropped = dropped
        self._dropped_before: Mapping[ChannelKey, int] = {}
        """In parts that are over."""
        self._dropped_told: Mapping[ChannelKey, int] = {}
        self._part: PartWriter | None = None
        self._channels: Mapping[int, RecordedChannel] = {}
        self._start_ns = 0
        make_private_folder(folder)
        numbers = (PART_NAME.fullmatch(path.name) for path in folder.iterdir())
        self._next_number = 1 + max((int(match["number"]) for match in numbers if match), default=-1)

    def write(self, chunk: Chunk, channels: Mapping[int, RecordedChannel]) -> None:
        """Write a chunk.

        Args:
            chunk: its messages.
            channels: of the recording, by their ids.
        """
        self._channels = channels
        if self._part is not None and self._is_full(self._part, chunk):
            self.end_part()
        part = self._part
        if part is None:
            part = self._part = self._begin(chunk)
        self.removed += len(self._budget.make_room(part.bytes + len(chunk.data)))
        before = part.bytes
        try:
            part.write(chunk, channels)
        except OSError:
            self._give_up(part)
            raise
        self.bytes += part.bytes - before

    def _is_full(self, part: PartWriter, chunk: Chunk) -> bool:
        split = self._split
        return (0 < split.bytes <= part.bytes + len(chunk.data)) or (
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
        """Have the disk keep what was written, and what is known to be missing."""
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
        """End the part that is being written; the next chunk begins another one."""
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
        """End a part behind its last whole chunk; if there is no room even for its summary, without one."""
        if not part.is_finished:
            with contextlib.suppress(OSError):
                self._tell_counts(part)
                part.finish()
        self._forget(part)

    def _forget(self, part: PartWriter) -> None:
        part.close()
        self._dropped_before = self._dropped_told
        self._part = None

    def _tell_counts(self, part: PartWriter) -> None:
        dropped = dict(self._dropped())
        counts = {self._channels[id_].key: ChannelCount(count) for id_, count in part.counts.items()}
        for key, total in dropped.items():
            new = total - self._dropped_before.get(key, 0)
            if new > 0 or key in counts:
                counts.setdefault(key, ChannelCount()).dropped = max(0, new)
        part.add_metadata(COUNTS_METADATA, counts_metadata(counts.items()))
        self._dropped_told = dropped

    def close(self) -> None:
        """End the recording; one without any message leaves no folder."""
        try:
            self.end_part()
        finally:
            with contextlib.suppress(OSError):
                self.folder.rmdir()
