"""The message logger: records a run's messages into a log, and counts those it could not record."""

import errno
import logging
import os
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.channels import ChannelCounters, messages_missed
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.logs.capture.position import Position
from robbie_mp.logs.capture.recorded_run import RecordedRun
from robbie_mp.logs.capture.recording_session import RecordingSession
from robbie_mp.logs.capture.selection import Selection
from robbie_mp.logs.capture.tally import Tally, UnendedParts
from robbie_mp.logs.recording.chunk import Compression
from robbie_mp.logs.recording.chunk_queue import BufferLimits
from robbie_mp.logs.recording.disk_budget import DiskBudget
from robbie_mp.logs.recording.format import ChannelKey, RecordedCount
from robbie_mp.logs.recording.log_writer import LogWriter, Split
from robbie_mp.logs.recording.recorder import LOGGER_NICE
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.module import Module, setting
from robbie_mp.module.settings import SettingError
from robbie_mp.run.run_directory import list_runs

WARN_UNMATCHED_AFTER_S = 10.0
MEGABYTE = 1e6
MAX_READ_S = 5.0
"""How long the end of a run waits until the part that a killed logger left has been read."""

RECORDING_INTO = "recording into "
"""Begins the line of the log that says where it records, by which reports find the recording."""


class MessageLogger(Module):
    """Records messages unchanged into MCAP files, which ROS 2 tools can open too.

    Name it first in the profile: the first module started stops last, so the logger receives everything that
    is published before shutdown:
    `logger: {class: "robbie_mp.logs.message_logger:MessageLogger", stop_grace_s: 10}`.
    """

    period_s = 1.0
    patience_s = 0.02
    nice = LOGGER_NICE
    follows_run_clock = False
    tells_where = logging.INFO
    """The level at which the log says where it records."""

    types: list[str] = setting(["*"], "patterns of the types to record, such as sensor_msgs/msg/*")
    topics: list[str] = setting(["*"], "patterns of the topics to record; '': messages without a topic")
    exclude: list[str] = setting([], "patterns of types and topics not to record")
    folder: Path | None = setting(
        None, "folder for recordings, each in its own subfolder; null: the run's output folder"
    )
    compression: Compression = setting(Compression.ZSTD, "compression of the log: zstd, lz4 or none")
    chunk_bytes: int = setting(1 << 20, "size of the chunks that are compressed and written", minimum=1024)
    split_bytes: int = setting(1 << 30, "size at which the next part of the log begins; 0: never", minimum=0)
    split_s: float = setting(0.0, "time after which the next part of the log begins; 0: never", minimum=0.0)
    budget_bytes: int = setting(0, "total size of all recordings in the folder; 0: unlimited", minimum=0)
    sync_s: float = setting(1.0, "time within which a message is on the disk", minimum=0.01)
    buffer_bytes: int = setting(1 << 27, "bytes of messages that may wait in memory", minimum=1 << 16)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check that the folder is writable and that the limits fit together."""
        budget, split = int(str(settings["budget_bytes"])), int(str(settings["split_bytes"]))
        if budget and not 0 < split <= budget // 2:
            raise SettingError(
                f"a budget of {budget} bytes needs parts of at most half that size; set split_bytes",
                "split_bytes",
            )
        if settings["folder"] is not None:
            _check_writable(Path(str(settings["folder"])))

    def setup(self) -> None:
        """Start the recording, or continue it after a restart, and subscribe."""
        self.run = RecordedRun(next(run.folder for run in list_runs() if run.run_id == self.run_id))
        self.selection = Selection.by_types_and_topics(self.types, self.topics, self.exclude)
        for type_of, topic in self.selection.pairs:
            self.subscribe_encoded(type_of, self.on_message, topic=topic)
        slot = self.run.plan.names.index(self.name)
        recording = self.recording_folder()
        self.position = self._open_position()
        self.tally = self._open_tally()
        self.unended = UnendedParts(recording, self.tally.next_part) if self.tally else None
        self.session = RecordingSession(
            self.run,
            self.selection,
            lambda dropped: self.make_writer(recording, dropped),
            BufferLimits(self.chunk_bytes, self.buffer_bytes, self.sync_s / 2),
            total_missed=lambda: messages_missed(self.run.core, slot),
            passed=ChannelCounters(self.run.core).messages,
            log=self.log,
            missed_before=self.restored or 0,
            tally=self.tally,
            position=self.position,
        )
        self.began_ns = self.clock.monotonic_ns()
        self.shown = (self.began_ns, 0, 0)
        self.warned = False
        self.log.log(self.tells_where, "%s%s", RECORDING_INTO, recording)

    def recording_folder(self) -> Path:
        """Return the folder of the recording, the same one after a restart."""
        return self.run.recording_folder(self.folder or self.output_directory, self.name)

    def _open_position(self) -> Position:
        """Open the position in the order of the run, which outlives this process."""
        try:
            return Position.kept(self.run.begin, *self._place)
        except OSError as error:
            self.log.warning("older messages may be recorded again if this logger is killed: %s", error)
            return Position(0)

    @property
    def _place(self) -> tuple[Path, str]:
        """Folder and name of what outlives this process."""
        return SHARED_MEMORY / names.folder(self.run_id), f"tally-{self.name}"

    def _open_tally(self) -> Tally | None:
        """Open the counts that outlive this process."""
        try:
            return Tally(*self._place)
        except OSError as error:
            self.log.warning("what this logger has in memory will not be counted if it is killed: %s", error)
            return None

    def make_writer(self, recording: Path, dropped: Callable[[], Mapping[ChannelKey, int]]) -> LogWriter:
        """Make the log writer.

        Args:
            recording: the folder of the recording.
            dropped: returns how many messages are missing, by channel.
        """
        return LogWriter(
            recording,
            self.compression,
            self.run.metadata(),
            Split(self.split_bytes, self.split_s),
            DiskBudget(recording.parent, self.budget_bytes),
            dropped,
            self.end_part,
            self.run.keep_limits,
        )

    def end_part(self, number: int, counts: Mapping[ChannelKey, RecordedCount]) -> None:
        """Note that a part of the log has ended; the writing thread calls it."""
        if self.tally:
            self.tally.end_part(number, counts)

    # -- messages --------------------------------------------------------------------------------------

    def on_message(self, message: EncodedMessage) -> None:
        """Record a message."""
        envelope = self.envelope
        key = ChannelKey(message.type_name, message.version, envelope.topic, envelope.sender)
        self.session.record(key, envelope.sequence, envelope.published_ns, message.data)

    # -- ticks -----------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Count missing messages, and update the status."""
        self._count_missed()
        self._count_lost(wait_s=0.0)
        now_ns = self.clock.monotonic_ns()
        if not self.warned and now_ns - self.began_ns > WARN_UNMATCHED_AFTER_S * 1e9:
            self._warn_unmatched("yet")
        self._show(now_ns)

    def _count_missed(self) -> None:
        """Count what the core dropped, and checkpoint it, so that a restart does not count it again."""
        before = self.session.missed
        self.session.count_missed()
        if self.session.missed != before:
            self.checkpoint(self.session.missed)

    def _count_lost(self, wait_s: float) -> None:
        """Count once what a killed logger had in memory, as soon as its last part has been read."""
        unended, self.unended = self.unended, None
        if unended is None:
            return
        counts = unended.counts(wait_s)
        if counts is None:
            self.unended = unended
            return
        self.session.count_lost(counts, unended.after)
        if self.session.lost:
            self.log.error(
                "%d messages are missing: they were in the memory of a logger that was killed",
                self.session.lost,
            )

    def _warn_unmatched(self, when: str) -> None:
        self.warned = True
        for patterns in self.selection.unmatched:
            self.log.warning(
                "nothing has been recorded %s for %s: check that a module publishes it", when, patterns
            )

    def _show(self, now_ns: int) -> None:
        recorder, writer = self.session.recorder, self.session.recorder.writer
        messages = self.session.received
        before_ns, messages_before, bytes_before = self.shown
        self.shown = (now_ns, messages, self.session.bytes)
        seconds = max(1e-3, (now_ns - before_ns) / 1e9)
        parts = [
            f"{(messages - messages_before) / seconds:.0f} messages/s",
            f"{(self.session.bytes - bytes_before) / MEGABYTE / seconds:.1f} MB/s",
            f"log {writer.bytes / MEGABYTE:.0f} MB in {writer.parts} parts",
            f"{recorder.waiting_bytes / MEGABYTE:.1f} MB in memory",
            f"dropped {sum(recorder.dropped().values())}",
        ]
        if self.session.lost:
            parts[-1] += f" ({self.session.lost} of them were in the memory of a killed logger)"
        if writer.newest.left_out:
            parts.append(f"{writer.newest.left_out} latched messages too large for the beginning of a part")
        self.degraded = f"cannot write: {recorder.error}" if recorder.error else ""
        if recorder.error:
            parts.insert(0, f"CANNOT WRITE: {recorder.error}")
        self.status = ", ".join(parts)

    def teardown(self) -> None:
        """Write what waits in memory, end the log, and log a summary of it."""
        self._end_log()
        self._warn_unmatched("in this run")
        counts = self.session.recorder.counts()
        self.log.info(
            "recorded %d messages into %s, %d bytes",
            sum(recorded for recorded, _ in counts.values()),
            self.session.folder,
            self.session.recorder.writer.bytes,
        )
        for key, (_, dropped) in counts.items():
            if dropped:
                self.log.error("%d messages are missing: %s on topic %r", dropped, key.type_name, key.topic)
        self._show(self.clock.monotonic_ns())

    def _end_log(self) -> None:
        self._count_missed()
        self._count_lost(wait_s=MAX_READ_S)
        if self.unended is not None:
            self.log.error(
                "what a killed logger had in memory is not counted: its part takes too long to read"
            )
        with closing(self.run):
            self.session.close()
        self.position.close()
        if self.tally:
            self.tally.close()


def _check_writable(folder: Path) -> None:
    """Raise SettingError if a folder cannot be created or written to."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise SettingError(f"{folder}: {existing} is not a folder", "folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        reason = os.strerror(errno.EROFS if _is_read_only(existing) else errno.EACCES)
        raise SettingError(f"{folder} cannot be written to: {reason}", "folder")


def _is_read_only(folder: Path) -> bool:
    return bool(os.statvfs(folder).f_flag & os.ST_RDONLY)
