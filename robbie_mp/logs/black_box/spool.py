"""The spool: what of the last messages outlives a power cut, as a small log on the disk."""

import contextlib
import fcntl
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from robbie_mp.base.linux.private_files import make_private_folder, private_opener, real_folder, write_private
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.capture.recorded_run import RecordedRun
from robbie_mp.logs.recording.chunk import Compression
from robbie_mp.logs.recording.chunk_queue import BufferLimits
from robbie_mp.logs.recording.disk_budget import DiskBudget
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.logs.recording.log_writer import LogWriter, Split
from robbie_mp.logs.recording.recorder import Recorder
from robbie_mp.run.results import NAME as RESULTS

SPOOL, LOG, ABOUT = "spool", "recent", "spool.json"
MAX_ABOUT_BYTES = 1 << 16
BYTES_PER_S = 1 << 17
"""What the spool takes before compression: at most 4 GB in eight hours, for the sake of memory cards."""
MAX_MESSAGE_BYTES = 1 << 14
"""Larger messages, such as images, are left out."""
PARTS = 4
"""Parts that the budget holds."""
BUFFER_BYTES = 1 << 22
CLOSE_S = 2.0
"""How long the end of a run waits for a disk that has stalled."""


@dataclass(frozen=True)
class AboutSpool:
    """The file `spool.json` in the folder of a spool."""

    run_id: str
    profile: str
    clips_bytes: int

    @classmethod
    def read(cls, folder: Path) -> "AboutSpool | None":
        """Return what a spool says about its run; None if it cannot be read."""
        with (
            contextlib.suppress(OSError, ValueError),
            open(folder / ABOUT, "rb", opener=private_opener) as file,
        ):
            return msgspec.json.decode(file.read(MAX_ABOUT_BYTES), type=cls)
        return None


def spool_folders(output_directory: Path) -> Iterator[Path]:
    """Yield the spools of a run, and of the earlier runs beside it, as far as they exist."""
    is_one_of_many = RESULTS.fullmatch(output_directory.name) is not None
    yield from (output_directory.parent.glob(f"*/{SPOOL}") if is_one_of_many else [output_directory / SPOOL])


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Lock the folder of a spool; yield False if another process, such as its black box, holds the lock."""
    with real_folder(folder) as fd:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


class Spool:
    """Writes the newest small messages to the disk every few seconds.

    Its threads alone touch the disk. If that stalls or refuses, messages are dropped and counted.

    Args:
        output_directory: the results of the run.
        about: the run.
        run: the same.
        bytes: limit for its files.
        every_s: a message is on the disk at most so long after it came.
        log: receives errors.
    """

    def __init__(
        self,
        output_directory: Path,
        about: AboutSpool,
        run: RecordedRun,
        bytes: int,
        every_s: float,
        log: logging.Logger,
    ):
        self.folder = output_directory / SPOOL
        self._about = about
        self._run = run
        self._bytes = bytes
        self._every_s = every_s
        self._log = log
        self._recorder: Recorder | None = None
        self._channels: dict[ChannelKey, int] = {}
        self._latched = run.latched()
        self._room = self._most_room = BYTES_PER_S * max(1.0, every_s)
        """Bytes that it may take at once; they come back with time."""
        self._took_s = time.monotonic()
        self.left_out = 0
        """Messages that it did not take: too large, or too many."""
        self.error = ""
        self._locks = contextlib.ExitStack()
        self._begin_thread = threading.Thread(target=self._begin, name="spool begin", daemon=True)
        self._begin_thread.start()

    def _begin(self) -> None:
        """Make the files: in a thread, as the disk may stall."""
        try:
            make_private_folder(self.folder)
            if not self._locks.enter_context(locked(self.folder)):
                self.error = "another process uses its folder"
                return
            self._clear()
            write_private(self.folder / ABOUT, msgspec.json.encode(self._about))
            limits = BufferLimits(1 << 18, BUFFER_BYTES, self._every_s)
            self._recorder = Recorder(self._writer, limits, self._log)
        except OSError as error:
            self.error = error.strerror or str(error)
            self._log.warning("a power cut would lose the last messages: %s", self.error)

    def _clear(self) -> None:
        """Remove what another run has left that no clip could be made of."""
        about = AboutSpool.read(self.folder)
        if about is None or about.run_id != self._about.run_id:
            shutil.rmtree(self.folder / LOG, ignore_errors=True)

    def _writer(self, dropped: Callable[[], Mapping[ChannelKey, int]]) -> LogWriter:
        keep = self._run.keep_limits
        return LogWriter(
            self.folder / LOG,
            Compression.ZSTD,
            self._run.metadata(),
            Split(self._bytes // PARTS),
            DiskBudget(self.folder, self._bytes),
            dropped,
            keep=replace(keep, bytes=min(keep.bytes, self._bytes // PARTS // 2)),
        )

    def keep(self, key: ChannelKey, sequence: int, published_ns: int, data: bytes | memoryview) -> None:
        """Take a message if it is small, and there are not too many."""
        recorder = self._recorder
        if recorder is None:
            return
        channel = self._channels.get(key) or self._open(recorder, key)
        now_s = time.monotonic()
        room = self._room + (now_s - self._took_s) * BYTES_PER_S
        self._room = room = room if room < self._most_room else self._most_room
        self._took_s = now_s
        if len(data) > MAX_MESSAGE_BYTES or len(data) > room:
            self.left_out += 1
            recorder.count_dropped(key, 1)
            return
        self._room -= len(data)
        recorder.record(channel, sequence, self._run.time_ns(published_ns), data)

    def _open(self, recorder: Recorder, key: ChannelKey) -> int:
        schema = self._run.schema(key.type_name, key.version)
        is_latched = ChannelName(*key[:3]) in self._latched
        found = self._channels[key] = recorder.channel(key, schema, is_latched=is_latched)
        return found

    def look(self) -> None:
        """Notice which channels have been latched meanwhile."""
        latched = self._run.latched()
        if latched != self._latched:
            self._latched = latched
            self._channels.clear()

    @property
    def problem(self) -> str:
        """Why nothing can be written at the moment; '' if it can."""
        return self.error or (self._recorder.error if self._recorder else "")

    def close(self) -> None:
        """End and remove it: the run has ended in order, and its clips are written."""
        ending = threading.Thread(target=self._end, name="spool end", daemon=True)
        ending.start()
        ending.join(CLOSE_S)
        if ending.is_alive():
            self._log.warning("%s is not removed: the disk has stalled", self.folder)

    def _end(self) -> None:
        self._begin_thread.join()
        with self._locks:
            if self._recorder is not None:
                with contextlib.suppress(RuntimeError):  # RecordingFailed, which has been reported
                    self._recorder.close()
            if not self.error:
                remove_spool(self.folder)


def remove_spool(folder: Path) -> None:
    """Remove a spool's own files, and not what a link leads to; call it with the lock."""
    if not os.path.islink(folder):
        shutil.rmtree(folder / LOG, ignore_errors=True)
        with contextlib.suppress(OSError):
            (folder / ABOUT).unlink()
            folder.rmdir()
