"""Chunks between the thread that fills them and the thread that writes them; bounded in bytes."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from robbie_mp.logs.recording.chunk import RECORD_HEAD_BYTES, Chunk


@dataclass(frozen=True)
class BufferLimits:
    """Limits for messages that wait in memory."""

    chunk_bytes: int
    """A chunk is closed when it reaches this size."""
    buffer_bytes: int
    """Limit for all waiting messages; messages beyond it are not taken."""
    close_after_s: float
    """A chunk is closed at the latest this long after its first message."""
    keep_s: float = 0.0
    """Chunks are discarded after this time unless a snapshot is requested; 0: all are written."""


class ChunkQueue:
    """Takes messages from one thread and hands chunks to another.

    Args:
        limits: how much the queue may hold, and for how long.
        monotonic_ns: returns the time of the machine's clock.
        on_discard: called with each chunk, in their order, that was kept but is not written.
    """

    def __init__(
        self,
        limits: BufferLimits,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        on_discard: Callable[[Chunk], None] = lambda _chunk: None,
    ):
        self._limits = limits
        self._on_discard = on_discard
        self._monotonic_ns = monotonic_ns
        self._close_after_ns = round(limits.close_after_s * 1e9)
        self._condition = threading.Condition(threading.Lock())
        self._open: Chunk | None = None
        self._closed: deque[Chunk] = deque()
        self._kept: deque[Chunk] = deque()
        self._bytes = 0
        self._ended = False

    @property
    def waiting_bytes(self) -> int:
        """Bytes of messages that wait or are being written."""
        return self._bytes

    @property
    def ended(self) -> bool:
        """Whether no more messages will be added."""
        return self._ended

    def add(self, channel_id: int, sequence: int, time_ns: int, data: bytes | memoryview) -> bool:
        """Copy a message; False if there is no room for it.

        A message larger than the whole buffer is taken when nothing else waits.
        """
        size = RECORD_HEAD_BYTES + len(data)
        limits = self._limits
        with self._condition:
            if self._bytes + size > limits.buffer_bytes and not self._make_room(size):
                return False
            self._bytes += size
            chunk = self._open
            if chunk is None:
                chunk = self._open = Chunk(self._monotonic_ns())
                self._condition.notify()  # the writer must know when the chunk is due
            chunk.add(channel_id, sequence, time_ns, data)
            if len(chunk.data) >= limits.chunk_bytes:
                self._close_open()
        return True

    def _make_room(self, size: int) -> bool:
        while self._kept and self._bytes + size > self._limits.buffer_bytes:
            self._discard_oldest()
        return self._bytes + size <= self._limits.buffer_bytes or not self._bytes

    def _close_open(self) -> None:
        if self._open is not None:
            (self._kept if self._limits.keep_s else self._closed).append(self._open)
            self._open = None
            self._condition.notify()

    def take(self, until_ns: int | None) -> Chunk | None:
        """Wait for the next chunk to be written and return it; None at `until_ns`, or at the end.

        The chunk counts as waiting until `written` is called.
        """
        with self._condition:
            while True:
                now_ns = self._monotonic_ns()
                if self._open is not None and (
                    self._ended or now_ns >= self._open.opened_ns + self._close_after_ns
                ):
                    self._close_open()
                self._forget_old(now_ns)
                if self._closed:
                    return self._closed.popleft()
                if self._ended or (until_ns is not None and now_ns >= until_ns):
                    return None
                self._condition.wait(self._wait_s(now_ns, until_ns))

    def _wait_s(self, now_ns: int, until_ns: int | None) -> float | None:
        due = [] if until_ns is None else [until_ns]
        if self._open is not None:
            due.append(self._open.opened_ns + self._close_after_ns)
        return (min(due) - now_ns) / 1e9 if due else None

    def _forget_old(self, now_ns: int) -> None:
        """Discard the oldest chunk as soon as the next one goes back far enough."""
        oldest_ns = now_ns - round(self._limits.keep_s * 1e9)
        while len(self._kept) > 1 and self._kept[1].opened_ns <= oldest_ns:
            self._discard_oldest()

    def _discard_oldest(self) -> None:
        chunk = self._kept.popleft()
        self._bytes -= len(chunk.data)
        self._on_discard(chunk)

    def written(self, chunk: Chunk) -> None:
        """Release a chunk that was taken."""
        with self._condition:
            self._bytes -= len(chunk.data)

    def write_kept(self) -> None:
        """Hand out all chunks kept until now."""
        with self._condition:
            self._close_open()
            self._closed.extend(self._kept)
            self._kept.clear()
            self._condition.notify()

    def kept_s(self) -> float:
        """Return the time span of the messages in memory."""
        with self._condition:
            first = self._kept[0] if self._kept else self._open
            return 0.0 if first is None else (self._monotonic_ns() - first.opened_ns) / 1e9

    def end(self) -> None:
        """Take no more messages. Chunks due to be written can still be taken; kept chunks are discarded."""
        with self._condition:
            if self._limits.keep_s:
                self._close_open()
                self._bytes -= sum(len(chunk.data) for chunk in self._kept)
                self._kept.clear()
            self._ended = True
            self._condition.notify()

    def sleep(self, seconds: float) -> None:
        """Sleep, but no longer than until the end."""
        with self._condition:
            self._condition.wait_for(lambda: self._ended, seconds)
