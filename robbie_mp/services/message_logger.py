"""The message logger: records what passes on the bus into a log, and says what it could not record."""

import errno
import os
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

from robbie_mp.capture.queue_drops import QueueDrops, key_of_missing
from robbie_mp.capture.recorded_run import RecordedRun
from robbie_mp.capture.selection import Pair, Selection, type_pattern
from robbie_mp.messages import ModuleState
from robbie_mp.module.bus import EncodedMessage
from robbie_mp.module.module import Module, setting
from robbie_mp.module.settings import SettingError
from robbie_mp.observe.channel_counters import ChannelCounters, messages_missed
from robbie_mp.recording.chunk_queue import BufferLimits
from robbie_mp.recording.compression import Compression
from robbie_mp.recording.disk_budget import DiskBudget
from robbie_mp.recording.format import ChannelKey
from robbie_mp.recording.log_writer import LogWriter, Split
from robbie_mp.recording.recorder import LOGGER_NICE, Recorder
from robbie_mp.run.run_directory import list_runs
from robbie_mp.transport import names
from robbie_mp.transport.layout import SegmentKind
from robbie_mp.transport.segment import Segment
from robbie_mp.transport.tables import ChannelName

WARN_UNMATCHED_AFTER_S = 10.0
CRASHED = ("BACKOFF", "FAILED")
MODULE_STATES = Pair(ModuleState.type_name, "*")
MEGABYTE = 1e6


class MessageLogger(Module):
    """Records messages, as they are, into MCAP files that tools for ROS 2 open too.

    In a robot's profile, before all other modules, so that it stops last and hears the others out:
    `logger: {class: "robbie_mp.services.message_logger:MessageLogger", stop_grace_s: 10}`.
    """

    period_s = 1.0
    patience_s = 0.02
    nice = LOGGER_NICE
    follows_run_clock = False

    types: list[str] = setting(["*"], "patterns for the types that are recorded, as sensor_msgs/msg/*")
    topics: list[str] = setting(["*"], "patterns for the topics that are recorded; '': messages without one")
    exclude: list[str] = setting([], "patterns for types and topics that are not recorded")
    folder: Path | None = setting(None, "where recordings go, a folder for each; null: the run's output")
    compression: Compression = setting(Compression.ZSTD, "of the log: zstd, lz4 or none")
    chunk_bytes: int = setting(1 << 20, "messages are compressed and written so many at once", minimum=1024)
    split_bytes: int = setting(1 << 30, "a part of the log ends with so many bytes; 0: never", minimum=0)
    split_s: float = setting(0.0, "a part of the log ends after so much time; 0: never", minimum=0.0)
    budget_bytes: int = setting(0, "all recordings in the folder, oldest removed first; 0: any", minimum=0)
    sync_s: float = setting(1.0, "a message is on the disk after so much time", minimum=0.01)
    buffer_bytes: int = setting(1 << 27, "messages that wait in memory; more are dropped", minimum=1 << 16)
    snapshot_s: float = setting(
        0.0, "record nothing but the last so many seconds before each trigger; 0: everything", minimum=0.0
    )
    trigger: str = setting("", "pattern for types whose messages trigger a snapshot")
    trigger_topic: str = setting("*", "pattern for their topics")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """See that files can be written where they are to be, and that limits go together."""
        budget, split = int(str(settings["budget_bytes"])), int(str(settings["split_bytes"]))
        if budget and not 0 < split <= budget // 2:
            raise SettingError(
                f"a budget of {budget} bytes needs parts of at most half as many; set split_bytes",
                "split_bytes",
            )
        if settings["folder"] is not None:
            _check_writable(Path(str(settings["folder"])))

    def setup(self) -> None:
        """Begin the recording, or go on with it, and subscribe."""
        self.run = RecordedRun(next(run.folder for run in list_runs() if run.run_id == self.run_id))
        self.selection = Selection.by_types_and_topics(self.types, self.topics, self.exclude)
        self.triggers = [Pair(type_pattern(self.trigger), self.trigger_topic)] if self.trigger else []
        self.channels: dict[ChannelKey, _Channel] = {}
        self.received: defaultdict[ChannelName, int] = defaultdict(int)
        self.bytes = 0
        pairs = self.selection.pairs + ([*self.triggers, MODULE_STATES] if self.snapshot_s else [])
        for type_of, topic in dict.fromkeys(pairs):
            self.subscribe_encoded(type_of, self.on_message, topic=topic)
        self.core = Segment.attach(names.core(self.run_id), SegmentKind.CORE).words
        self.slot = self.run.plan.names.index(self.name)
        self.counters = ChannelCounters(self.core)
        self.drops = QueueDrops(
            lambda: messages_missed(self.core, self.slot), self._passed, self.restored or 0
        )
        recording = self.run.recording_folder(self.folder or self.output_directory, self.name)
        self.recorder = Recorder(
            lambda dropped: self.make_writer(recording, dropped),
            BufferLimits(self.chunk_bytes, self.buffer_bytes, self.sync_s / 2, self.snapshot_s),
            self.log,
        )
        self.began_ns = self.clock.monotonic_ns()
        self.shown = (self.began_ns, 0, 0)
        self.warned = False
        self.log.info("recording into %s", recording)

    def make_writer(self, recording: Path, dropped: Callable[[], Mapping[ChannelKey, int]]) -> LogWriter:
        """Make what writes the recording.

        Args:
            recording: its folder.
            dropped: says how many messages of which channels are missing.
        """
        return LogWriter(
            recording,
            self.compression,
            self.run.metadata(),
            Split(self.split_bytes, self.split_s),
            DiskBudget(recording.parent, self.budget_bytes),
            dropped,
        )

    # -- messages --------------------------------------------------------------------------------------

    def on_message(self, message: EncodedMessage) -> None:
        """Copy a message to where it waits for the disk."""
        envelope = self.envelope
        key = ChannelKey(message.type_name, message.version, envelope.topic, envelope.sender)
        channel = self.channels.get(key) or self._open(key)
        self.received[channel.name] += 1
        if channel.id:
            time_ns = self.run.time_ns(envelope.published_ns)
            self.recorder.record(channel.id, envelope.sequence, time_ns, message.data)
            self.bytes += len(message.data)
        if channel.triggers:
            self._trigger(f"{key.type_name} on topic {key.topic!r}")
        if channel.tells_states:
            state = ModuleState.decode(message.data)
            if state.state in CRASHED:
                self._trigger(f"{state.module} is in state {state.state}: {state.reason}")

    def _open(self, key: ChannelKey) -> "_Channel":
        """Decide what is done with the messages of a channel, once."""
        id_ = 0
        if self.selection.wants(key.type_name, key.topic):
            schema = self.run.schema(key.type_name, key.version)
            if not schema:
                self.log.warning(
                    "%s, version %d, is recorded without a schema: no class of the robot's describes it",
                    key.type_name,
                    key.version,
                )
            id_ = self.recorder.channel(key, schema)
        states = bool(self.snapshot_s) and key.type_name == ModuleState.type_name
        triggers = bool(self.snapshot_s) and any(
            pair.matches(key.type_name, key.topic) for pair in self.triggers
        )
        channel = self.channels[key] = _Channel(key, id_, triggers=triggers, tells_states=states)
        return channel

    def _trigger(self, why: str) -> None:
        self.log.info("snapshot of the last %.1f s: %s", self.recorder.kept_s(), why)
        self.recorder.write_kept()

    # -- ticks -----------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Count what is missing, and show how it goes."""
        self._count_queue_drops()
        now_ns = self.clock.monotonic_ns()
        if not self.warned and now_ns - self.began_ns > WARN_UNMATCHED_AFTER_S * 1e9:
            self._warn_unmatched("so far")
        self._show(now_ns)

    def _passed(self) -> dict[ChannelName, int]:
        is_subscribed = self.selection.is_subscribed
        return {
            name: passed
            for name, passed in self.counters.messages().items()
            if is_subscribed(name.type_name, name.topic)
        }

    def _count_queue_drops(self) -> None:
        """Count what the core dropped, so that a later process of this module does not count it again."""
        before = self.drops.missed
        for name, missing in self.drops.look(self.received).items():
            if self.selection.wants(name.type_name, name.topic):
                self.recorder.count_dropped(key_of_missing(name, self.channels), missing)
        if self.drops.missed != before:
            self.checkpoint(self.drops.missed)

    def _warn_unmatched(self, when: str) -> None:
        self.warned = True
        for patterns in self.selection.unmatched:
            self.log.warning("nothing was recorded %s for %s: does anybody publish it?", when, patterns)

    def _show(self, now_ns: int) -> None:
        recorder, writer = self.recorder, self.recorder.writer
        messages = sum(self.received.values())
        before_ns, messages_before, bytes_before = self.shown
        self.shown = (now_ns, messages, self.bytes)
        seconds = max(1e-3, (now_ns - before_ns) / 1e9)
        parts = [
            f"{(messages - messages_before) / seconds:.0f} messages/s",
            f"{(self.bytes - bytes_before) / MEGABYTE / seconds:.1f} MB/s",
            f"log {writer.bytes / MEGABYTE:.0f} MB in {writer.parts} parts",
            f"{recorder.waiting_bytes / MEGABYTE:.1f} MB in memory",
            f"dropped {sum(recorder.dropped().values())}",
        ]
        if recorder.error:
            parts.insert(0, f"CANNOT WRITE: {recorder.error}")
        self.status = ", ".join(parts)

    def teardown(self) -> None:
        """Write what waits, end the log, and say what is in it."""
        self._count_queue_drops()
        self._warn_unmatched("in this run")
        with closing(self.run):
            self.recorder.close()
        recorded = sum(recorded for recorded, _ in self.recorder.counts().values())
        self.log.info(
            "recorded %d messages into %s, %d bytes",
            recorded,
            self.recorder.writer.folder,
            self.recorder.writer.bytes,
        )
        for key, (_, dropped) in self.recorder.counts().items():
            if dropped:
                self.log.error("%d messages are missing: %s on topic %r", dropped, key.type_name, key.topic)
        self._show(self.clock.monotonic_ns())


class _Channel:
    """What is done with the messages of a channel."""

    __slots__ = ("id", "name", "tells_states", "triggers")

    def __init__(self, key: ChannelKey, id_: int, *, triggers: bool, tells_states: bool):
        self.name = ChannelName(key.type_name, key.version, key.topic)
        self.id = id_
        """In the log; 0: they are not recorded."""
        self.triggers = triggers
        self.tells_states = tells_states


def _check_writable(folder: Path) -> None:
    """Raise SettingError if a folder cannot be made, or written into."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise SettingError(f"{folder}: {existing} is no folder", "folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        reason = os.strerror(errno.EROFS if _is_read_only(existing) else errno.EACCES)
        raise SettingError(f"{folder} cannot be written: {reason}", "folder")


def _is_read_only(folder: Path) -> bool:
    return bool(os.statvfs(folder).f_flag & os.ST_RDONLY)
