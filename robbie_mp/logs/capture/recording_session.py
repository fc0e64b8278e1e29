"""One recording of a run, for the message logger and `robbie record`."""

import logging
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path

from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.capture.position import Position
from robbie_mp.logs.capture.queue_drops import QueueDrops, key_of_missing
from robbie_mp.logs.capture.recorded_run import RecordedRun
from robbie_mp.logs.capture.selection import Selection
from robbie_mp.logs.capture.tally import Tally
from robbie_mp.logs.recording.chunk_queue import BufferLimits
from robbie_mp.logs.recording.format import ChannelKey, RecordedCount
from robbie_mp.logs.recording.log_writer import LogWriter
from robbie_mp.logs.recording.recorder import Recorder


class RecordingSession:
    """Records the selected messages of a run, and counts by channel the messages that never arrived.

    Args:
        run: the run.
        selection: selects the messages to record.
        make_writer: makes the log writer; see `Recorder`.
        limits: how much may wait in memory.
        total_missed: returns how many messages the core has dropped in total.
        passed: returns how many messages the core has routed through each channel.
        log: where warnings and errors go.
        missed_before: dropped messages that an earlier process of this recorder has counted already.
        tally: counts messages beyond the life of this process; None: nothing continues this recording.
        position: how far the recording has got; None: it begins with what is published from now on.

    Attributes:
        recorder: writes the log.
        lost: messages that were in the memory of an earlier process of this recorder when it died.
        bytes: size of all messages recorded.
    """

    def __init__(
        self,
        run: RecordedRun,
        selection: Selection,
        make_writer: Callable[[Callable[[], Mapping[ChannelKey, int]]], LogWriter],
        limits: BufferLimits,
        *,
        total_missed: Callable[[], int],
        passed: Callable[[], Mapping[ChannelName, int]],
        log: logging.Logger,
        missed_before: int = 0,
        tally: Tally | None = None,
        position: Position | None = None,
    ):
        self._run = run
        self._selection = selection
        self._log = log
        self._passed = passed
        self._channels: dict[ChannelKey, _Channel] = {}
        self._received: defaultdict[ChannelName, int] = defaultdict(int)
        self._left_out: defaultdict[ChannelKey, int] = defaultdict(int)
        """Messages left out since `count_missed` was called last."""
        self._drops = QueueDrops(total_missed, self._passed_and_subscribed, missed_before)
        self.recorder = Recorder(make_writer, limits, log)
        self._tally = tally
        self._position = position or Position(run.begin)
        self.bytes = 0
        self.lost = 0

    @property
    def folder(self) -> Path:
        """Folder of the log."""
        return self.recorder.writer.folder

    @property
    def received(self) -> int:
        """Messages received, recorded or not."""
        return sum(self._received.values())

    @property
    def missed(self) -> int:
        """Messages dropped by the core and counted so far."""
        return self._drops.missed

    def record(self, key: ChannelKey, sequence: int, published_ns: int, data: bytes | memoryview) -> None:
        """Record a message if it is selected.

        A message from before the recording, which the core has kept because its channel is latched, is not
        counted. The next part of the log begins with a copy of it, as each later part does.

        Args:
            key: its channel.
            sequence: its place in the order of the run.
            published_ns: when it was published, on the machine's monotonic clock.
            data: its encoding.
        """
        channel = self._channels.get(key) or self._open(key)
        if sequence <= self._position.sequence and channel.is_latched:
            if channel.id:
                self.recorder.carry(channel.id, sequence, self._run.time_ns(published_ns), data)
            return
        self._position.sequence = sequence
        self._received[channel.name] += 1
        if channel.id:
            self.recorder.record(channel.id, sequence, self._run.time_ns(published_ns), data)
            self.bytes += len(data)
            if self._tally is not None:
                self._tally.receive(key)

    def leave_out(self, key: ChannelKey, sequence: int, published_ns: int, data: bytes | memoryview) -> None:
        """Leave out a message on purpose; the log counts it as missing.

        If its channel is latched, the next part of the log begins with a copy of it all the same. The
        arguments are those of `record`.
        """
        channel = self._channels.get(key) or self._open(key)
        if channel.id and channel.is_latched:
            self.recorder.carry(channel.id, sequence, self._run.time_ns(published_ns), data)
            if sequence <= self._position.sequence:
                return
        self._position.sequence = sequence
        self._received[channel.name] += 1
        if channel.id:
            self._left_out[key] += 1
            if self._tally is not None:
                self._tally.receive(key)

    def add(self, key: ChannelKey, sequence: int, published_ns: int, data: bytes | memoryview) -> None:
        """Record a message that the recorder has made itself; the arguments are those of `record`."""
        channel = self._channels.get(key) or self._open(key)
        if channel.id:
            self.recorder.record(channel.id, sequence, self._run.time_ns(published_ns), data)

    def _open(self, key: ChannelKey) -> "_Channel":
        """Decide once whether the messages of a channel are recorded."""
        id_, is_latched = 0, ChannelName(*key[:3]) in self._run.latched()
        if self._selection.wants(key.type_name, key.topic):
            schema = self._run.schema(key.type_name, key.version)
            if schema is None:
                self._log.warning(
                    "%s, version %d, is recorded without a schema: no class of this robot describes it",
                    key.type_name,
                    key.version,
                )
            id_ = self.recorder.channel(key, schema, is_latched=is_latched)
        channel = self._channels[key] = _Channel(key, id_, is_latched)
        return channel

    def count_missed(self) -> None:
        """Count in the log the selected messages that were dropped or left out since the last call.

        It also notices which channels have been latched meanwhile.
        """
        latched = self._run.latched()
        for key, channel in [*self._channels.items()]:
            if not channel.is_latched and channel.name in latched:
                del self._channels[key]
        while self._left_out:
            self.recorder.count_dropped(*self._left_out.popitem())
        for name, missing in self._drops.look(self._received).items():
            if self._selection.wants(name.type_name, name.topic):
                key = key_of_missing(name, self._channels)
                self.recorder.count_dropped(key, missing)
                if self._tally is not None:
                    self._tally.miss(key, missing)

    def count_lost(self, unended: Mapping[ChannelKey, RecordedCount], first_part: int) -> None:
        """Count in the log what earlier processes of this recorder had in memory when they died.

        Args:
            unended: what is in the parts that they left without an end.
            first_part: number of the first part after these.
        """
        if self._tally is None:
            return
        for key, messages in self._tally.lost_before(unended, first_part).items():
            self.recorder.count_dropped(key, messages)
            self.lost += messages

    def _passed_and_subscribed(self) -> dict[ChannelName, int]:
        is_subscribed = self._selection.is_subscribed
        return {
            name: passed
            for name, passed in self._passed().items()
            if is_subscribed(name.type_name, name.topic)
        }

    def close(self) -> None:
        """Write what still waits in memory, and end the log."""
        self.recorder.close()


class _Channel:
    """A channel of which messages have been received."""

    __slots__ = ("id", "is_latched", "name")

    def __init__(self, key: ChannelKey, id_: int, is_latched: bool):
        self.name = ChannelName(key.type_name, key.version, key.topic)
        self.id = id_
        """The channel's number in the log; 0: its messages are not recorded."""
        self.is_latched = is_latched
