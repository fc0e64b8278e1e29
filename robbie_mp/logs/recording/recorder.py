"""Records messages: a separate thread writes them, so the recording thread never waits for a disk."""

import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Mapping

from robbie_mp.base.errors import RobbieError
from robbie_mp.logs.recording.chunk import Chunk
from robbie_mp.logs.recording.chunk_queue import BufferLimits, ChunkQueue
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.logs.recording.log_writer import LogWriter
from robbie_mp.logs.recording.part_writer import RecordedChannel

LOGGER_NICE = 10
"""Niceness of recording processes: compression must not hold up the robot."""
RETRY_S = 1.0
"""Delay before the next attempt after a failed write; the messages wait meanwhile."""


class RecordingFailed(RobbieError, RuntimeError):
    """The writing thread has ended with an error in our code."""


class Recorder:
    """Writes messages into a log.

    Call all methods from one thread; another thread writes the log.

    Args:
        make_writer: makes the writer; it receives a function that returns the dropped messages.
        limits: limits for messages that wait in memory.
        log: receives reports of disks that refuse to take data.
    """

    def __init__(
        self,
        make_writer: Callable[[Callable[[], Mapping[ChannelKey, int]]], LogWriter],
        limits: BufferLimits,
        log: logging.Logger,
    ):
        self._queue = ChunkQueue(limits)
        self._limits = limits
        self._log = log
        self._channels: dict[int, RecordedChannel] = {}
        self._ids: dict[tuple[ChannelKey, bool], int] = {}
        """By channel, and whether it is latched."""
        self._dropped: defaultdict[ChannelKey, int] = defaultdict(int)
        self._dropped_lock = threading.Lock()
        self.recorded: defaultdict[int, int] = defaultdict(int)
        """Number of messages in the log, by channel."""
        self.error = ""
        """Why nothing can be written at the moment."""
        self._failure: BaseException | None = None
        self._sync_due_ns: int | None = None
        self._ends_part = False
        self.writer = make_writer(self.dropped)
        self._thread = threading.Thread(target=self._run, name="log writer", daemon=True)
        self._thread.start()

    def channel(self, key: ChannelKey, schema: str | None, *, is_latched: bool = False) -> int:
        """Return the number of a channel, a new one if the channel is new.

        Args:
            key: what identifies it.
            schema: the ros2msg text of its type; None if it is not known.
            is_latched: whether each part of the log begins with a copy of its newest message.
        """
        found = self._ids.get((key, is_latched))
        if found is None:
            found = self._ids[key, is_latched] = len(self._channels) + 1
            carried_id = found + 1 if is_latched else 0
            if carried_id:
                self._channels[carried_id] = RecordedChannel(carried_id, key, schema, is_carried=True)
            self._channels[found] = RecordedChannel(found, key, schema, carried_id)
        return found

    def carry(self, channel_id: int, sequence: int, time_ns: int, data: bytes | memoryview) -> None:
        """Begin the next part of the log with a copy of a message from before the recording.

        It is not counted as recorded. If a newer message of the channel is known, nothing happens.

        Args:
            channel_id: as `channel` returned it, of a latched channel.
            sequence: its place in the order of the run.
            time_ns: when it was published, in ns since the epoch.
            data: its encoding.
        """
        self.writer.newest.keep(self._channels[channel_id], sequence, time_ns, bytes(data))

    def record(self, channel_id: int, sequence: int, time_ns: int, data: bytes | memoryview) -> bool:
        """Copy a message; False if it was dropped because there was no room in memory.

        Args:
            channel_id: as `channel` returned it.
            sequence: its place in the order of the run.
            time_ns: when it was published, in ns since the epoch.
            data: its encoding.

        Raises:
            RecordingFailed: nothing more will ever be written.
        """
        if self._failure is not None:
            raise RecordingFailed("the log is not written any more") from self._failure
        if self._queue.add(channel_id, sequence, time_ns, data):
            return True
        self.count_dropped(self._channels[channel_id].key, 1)
        return False

    def count_dropped(self, key: ChannelKey, messages: int) -> None:
        """Count messages that are missing from the log."""
        with self._dropped_lock:
            self._dropped[key] += messages

    def dropped(self) -> dict[ChannelKey, int]:
        """Return the number of missing messages by channel."""
        with self._dropped_lock:
            return dict(self._dropped)

    def counts(self) -> dict[ChannelKey, tuple[int, int]]:
        """Return for each channel how many messages were recorded, and how many are missing."""
        dropped = self.dropped()
        recorded: defaultdict[ChannelKey, int] = defaultdict(int)
        for id_, channel in self._channels.items():
            if not channel.is_carried:
                recorded[channel.key] += self.recorded[id_]
        return {key: (recorded.get(key, 0), dropped.get(key, 0)) for key in (*recorded, *dropped)}

    @property
    def waiting_bytes(self) -> int:
        """Bytes of messages in memory."""
        return self._queue.waiting_bytes

    def end_part(self) -> None:
        """End the part that is being written with the last message until now."""
        self._ends_part = True
        self._queue.flush()

    def flush(self, wait_s: float) -> None:
        """Write what was recorded until now, so that it outlives this process.

        Args:
            wait_s: wait for that, but no longer.
        """
        self._queue.flush()
        give_up_s = time.monotonic() + wait_s
        while (self.waiting_bytes or self._sync_due_ns is not None) and time.monotonic() < give_up_s:
            time.sleep(0.001)

    def close(self) -> None:
        """Write what still waits, end the log, and wait until that is done."""
        self._queue.end()
        self._thread.join()
        if self._failure is not None:
            raise RecordingFailed("the log was not written to its end") from self._failure

    # -- the writing thread ----------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while self._turn():
                pass
            self._attempt(lambda: self.writer.write_newest(self._channels))
            self._attempt(self.writer.close)
        except BaseException as failure:
            self._failure = failure
            self._log.exception("the log cannot be written")

    def _turn(self) -> bool:
        """Write a chunk, or sync the written data. Return False at the end."""
        queue = self._queue
        had_ended = queue.ended  # it may end during the disk sync, just after one more message arrived
        chunk = queue.take(self._sync_due_ns)
        if chunk is not None:
            self._write(chunk)
            queue.written(chunk)
        due = self._sync_due_ns
        if due is not None and (chunk is None or time.monotonic_ns() >= due):
            self._sync_due_ns = None
            self._attempt(self.writer.sync)
        if chunk is None and self._ends_part:
            self._ends_part = False
            self._attempt(self.writer.end_part)
        return chunk is not None or not had_ended

    def _write(self, chunk: Chunk) -> None:
        """Write a chunk, and retry until it succeeds; at the end try once more, then drop the chunk."""
        while not self._attempt(lambda: self.writer.write(chunk, self._channels)):
            if self._queue.ended:
                for id_, count in chunk.counts().items():
                    self.count_dropped(self._channels[id_].key, count)
                return
            self._queue.sleep(RETRY_S)
        for id_, count in chunk.counts().items():
            self.recorded[id_] += count
        if self._sync_due_ns is None:
            self._sync_due_ns = chunk.opened_ns + round(self._limits.close_after_s * 1e9)

    def _attempt(self, step: Callable[[], None]) -> bool:
        try:
            step()
        except OSError as error:
            if not self.error:
                self._log.error("the log in %s cannot be written: %s", self.writer.folder, error)
            self.error = str(error.strerror or error)
            return False
        if self.error:
            self._log.warning("the log in %s is written again", self.writer.folder)
            self.error = ""
        return True
