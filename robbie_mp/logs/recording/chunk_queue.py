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


class ChunkQueue:
    """Takes messages from one thread and hands chunks to another.

    Args:
        limits: how much the queue may hold, and for how long.
        monotonic_ns: returns the time of the machine's clock.
    """

    def __init__(
        self,
        limits: BufferLimits,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ):
        self._limits = limits
        self._monotonic_ns = monotonic_ns
        self._close_after_ns = round(limits.close_after_s * 1e9)
        self._lock = threading.Lock()
        self._condition = threading.Condition(self._lock)
        self._open: Chunk | None = None
        self._closed: deque[Chunk] = deque()
        self._bytes = 0
        self._ended = False
        self._is_flushed = False

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
        with self._lock:
            if self._bytes + size > limits.buffer_bytes and self._bytes:
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

    def _close_open(self) -> None:
        if self._open is not None:
            self._closed.append(self._open)
            self._open = None
            self._condition.notify()

    def take(self, until_ns: int | None) -> Chunk | None:
        """Wait for the next chunk to be written and return it.

        It returns None at `until_ns`, after a flush, and at the end.

        The chunk counts as waiting until `written` is called.
        """
        with self._lock:
            while True:
                now_ns = self._monotonic_ns()
                if self._open is not None and (
                    self._ended or now_ns >= self._open.opened_ns + self._close_after_ns
                ):
                    self._close_open()
                if self._closed:
                    return self._closed.popleft()
                if self._ended or self._is_flushed or (until_ns is not None and now_ns >= until_ns):
                    self._is_flushed = False
                    return None
                self._condition.wait(self._wait_s(now_ns, until_ns))

    def _wait_s(self, now_ns: int, until_ns: int | None) -> float | None:
        due = [] if until_ns is None else [until_ns]
        if self._open is not None:
            due.append(self._open.opened_ns + self._close_after_ns)
        return (min(due) - now_ns) / 1e9 if due else None

    def flush(self) -> None:
        """Hand out all that has been added until now, and then let `take` return None."""
        with self._lock:
            self._close_open()
            self._is_flushed = True
            self._condition.notify()

    def written(self, chunk: Chunk) -> None:
        """Release a chunk that was taken."""
        with self._lock:
            self._bytes -= len(chunk.data)

    def end(self) -> None:
        """Take no more messages. Chunks that wait can still be taken."""
        with self._lock:
            self._ended = True
            self._condition.notify()

    def sleep(self, seconds: float) -> None:
        """Sleep, but no longer than until the end."""
        with self._lock:
            self._condition.wait_for(lambda: self._ended, seconds)
