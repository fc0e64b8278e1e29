"""Keeps the newest message of each latched channel, so that each part of a recording can begin with them."""

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.recording.chunk import Chunk
from robbie_mp.logs.recording.part_writer import RecordedChannel

CHUNK_BYTES = 1 << 20
"""Size from which on copies begin another chunk."""
SEQUENCE_VALUES = 1 << 32
"""Logs have sequence numbers modulo this number."""


@dataclass(frozen=True)
class KeepLimits:
    """Limits for the newest messages; beyond them, the oldest is left out and counted."""

    messages: int = 1024
    bytes: int = 256 << 20


class _Kept(NamedTuple):
    """The newest message of a channel."""

    carried_id: int
    sequence: int
    published_ns: int
    data: bytes


class NewestMessages:
    """The newest messages of a recording's latched channels: one for each type and topic, as in the core.

    Any thread may call it.

    Args:
        limits: how much it keeps.

    Attributes:
        left_out: number of messages that were left out because of the limits.
    """

    def __init__(self, limits: KeepLimits = KeepLimits()):
        self._limits = limits
        self._lock = threading.Lock()
        self._kept: dict[ChannelName, _Kept] = {}
        """By channel, the oldest first."""
        self._bytes = 0
        self.left_out = 0

    def keep(self, channel: RecordedChannel, sequence: int, published_ns: int, data: bytes) -> None:
        """Keep a message of a latched channel if it is newer than the one that is kept."""
        name = ChannelName(*channel.key[:3])
        with self._lock:
            known = self._kept.get(name)
            if known is not None and not _is_later(sequence, known.sequence):
                return
            if known is not None:
                self._forget(name)
            self._kept[name] = _Kept(channel.carried_id, sequence % SEQUENCE_VALUES, published_ns, data)
            self._bytes += len(data)
            while len(self._kept) > self._limits.messages or self._bytes > self._limits.bytes:
                self._forget(next(iter(self._kept)))
                self.left_out += 1

    def _forget(self, name: ChannelName) -> None:
        self._bytes -= len(self._kept.pop(name).data)

    def keep_from(self, chunk: Chunk, channels: Mapping[int, RecordedChannel]) -> None:
        """Keep the newest messages of a chunk, which comes next in the order of the run."""
        latched = [channels[id_] for id_ in chunk.index if channels[id_].carried_id]
        newest = [(*chunk.newest(channel.id), channel) for channel in latched]
        for sequence, time_ns, data, channel in newest:
            self.keep(channel, sequence, time_ns, data)

    def copies(self, time_ns: int, before: int | None = None) -> list[Chunk]:
        """Return chunks with copies of all messages kept, in the order of the run.

        Args:
            time_ns: log time of the copies.
            before: leave out messages from this sequence number on; None: none.
        """
        with self._lock:
            kept = [one for one in self._kept.values() if before is None or _is_later(before, one.sequence)]
        chunks: list[Chunk] = []
        for one in sorted(kept, key=lambda one: (one.published_ns, one.sequence)):
            if not chunks or len(chunks[-1].data) >= CHUNK_BYTES:
                chunks.append(Chunk(0))
            chunks[-1].add(one.carried_id, one.sequence, time_ns, one.data, one.published_ns)
        return chunks

    @property
    def newest_ns(self) -> int | None:
        """When the newest of the messages was published; None if there are none."""
        with self._lock:
            return max((one.published_ns for one in self._kept.values()), default=None)


def _is_later(sequence: int, other: int) -> bool:
    """Whether a sequence number comes after another; both are only known modulo 2^32."""
    return 0 < (sequence - other) % SEQUENCE_VALUES < SEQUENCE_VALUES // 2
