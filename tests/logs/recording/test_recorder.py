"""Messages wait in memory for the disk, within a bound; the recording thread never waits."""

import logging
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from robbie_mp.logs.recording import recorder as recorder_module
from robbie_mp.logs.recording.chunk import Chunk, Compression
from robbie_mp.logs.recording.chunk_queue import BufferLimits, ChunkQueue
from robbie_mp.logs.recording.disk_budget import DiskBudget
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.logs.recording.log_writer import LogWriter, Split
from robbie_mp.logs.recording.part_writer import RecordedChannel
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.logs.recording.recorder import Recorder, RecordingFailed
from tests._support.robot import wait_until
from tests.logs.recording._support.recording import CHANNELS, RUN

KEY, OTHER = CHANNELS[1].key, CHANNELS[2].key
LIMITS = BufferLimits(chunk_bytes=1000, buffer_bytes=5000, close_after_s=3600.0)
LOG = logging.getLogger("test")


class Disk(LogWriter):
    """A writer whose disk may be full, or slow, or its code wrong."""

    def __init__(
        self, folder: Path, dropped: Callable[[], Mapping[ChannelKey, int]], ended: list[int] | None = None
    ):
        budget = DiskBudget(folder.parent, 0)
        on_end = (lambda number, _counts: ended.append(number)) if ended is not None else lambda _n, _c: None
        super().__init__(folder, Compression.NONE, RUN, Split(), budget, dropped, on_end)
        self.free = threading.Event()
        self.free.set()
        self.refuse: Exception | None = None
        self.refused = threading.Event()

    def write(self, chunk: Chunk, channels: Mapping[int, RecordedChannel]) -> None:
        assert self.free.wait(60)
        if self.refuse is not None:
            self.refused.set()
            raise self.refuse
        super().write(chunk, channels)


def disk_of(recorder: Recorder) -> Disk:
    assert isinstance(recorder.writer, Disk)
    return recorder.writer


def record(recorder: Recorder, numbers: range, size: int = 100) -> list[int]:
    """Record messages on one channel; return those that were taken."""
    channel = recorder.channel(KEY, "")
    return [n for n in numbers if recorder.record(channel, n, n, n.to_bytes(4, "little") + bytes(size - 4))]


def recorded(folder: Path) -> list[int]:
    with open_log(folder) as log:
        return [message.sequence for message in log.messages()]


@pytest.fixture
def recorder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Recorder:
    monkeypatch.setattr(recorder_module, "RETRY_S", 0.001)
    return Recorder(lambda dropped: Disk(tmp_path / "log", dropped), LIMITS, LOG)


def test_messages_beyond_the_buffer_of_a_slow_disk_are_counted_in_the_log(
    recorder: Recorder, tmp_path: Path
) -> None:
    disk_of(recorder).free.clear()
    taken = record(recorder, range(100))
    assert taken == list(range(len(taken)))
    assert 30 < len(taken) < 40
    assert recorder.waiting_bytes <= LIMITS.buffer_bytes
    assert recorder.counts() == {KEY: (0, 100 - len(taken))}
    recorder.count_dropped(OTHER, 5)
    disk_of(recorder).free.set()
    recorder.close()
    assert recorded(tmp_path / "log") == taken
    assert recorder.counts() == {KEY: (len(taken), 100 - len(taken)), OTHER: (0, 5)}
    assert recorder.waiting_bytes == 0


def test_message_larger_than_the_buffer_is_accepted_if_it_is_alone(
    recorder: Recorder, tmp_path: Path
) -> None:
    assert record(recorder, range(1), size=20_000) == [0]
    recorder.close()
    assert recorded(tmp_path / "log") == [0]


def test_recording_continues_after_a_full_disk_has_room_again(
    recorder: Recorder, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    disk_of(recorder).refuse = OSError(28, "No space left on device")
    taken = record(recorder, range(20))
    assert disk_of(recorder).refused.wait(60)
    disk_of(recorder).refused.clear()
    assert disk_of(recorder).refused.wait(60)  # it tries again
    assert recorder.error == "No space left on device"
    disk_of(recorder).refuse = None
    recorder.close()
    assert recorded(tmp_path / "log") == taken == list(range(20))
    assert recorder.error == ""
    texts = [entry.getMessage() for entry in caplog.records if entry.levelno >= logging.WARNING]
    assert len(texts) == 2, texts
    assert "No space left" in texts[0]


def test_message_right_before_the_end_during_a_sync_is_recorded(tmp_path: Path) -> None:
    """A full chunk was written. While the disk syncs it, the robot publishes its last message and stops."""
    limits = BufferLimits(chunk_bytes=1000, buffer_bytes=5000, close_after_s=0.5)

    recorder: Recorder

    class SlowToSync(Disk):
        def sync(self) -> None:
            if not recorder._queue.ended:
                record(recorder, range(8, 9))
                recorder._queue.end()
            super().sync()

    recorder = Recorder(lambda dropped: SlowToSync(tmp_path / "log", dropped), limits, LOG)
    record(recorder, range(8))
    recorder._thread.join(60)
    assert recorded(tmp_path / "log") == list(range(9))


def test_messages_refused_by_a_full_disk_at_the_end_are_counted(recorder: Recorder) -> None:
    disk_of(recorder).refuse = OSError(28, "No space left on device")
    record(recorder, range(20))
    recorder.close()
    assert recorder.counts() == {KEY: (0, 20)}


def test_failing_writer_is_not_a_silent_loss(recorder: Recorder) -> None:
    disk_of(recorder).refuse = ZeroDivisionError()
    record(recorder, range(20))
    with pytest.raises(RecordingFailed):
        recorder.close()
    with pytest.raises(RecordingFailed):
        record(recorder, range(1))


def test_part_ends_with_the_last_message_before_it_was_asked_to(tmp_path: Path) -> None:
    limits = BufferLimits(chunk_bytes=1000, buffer_bytes=1 << 20, close_after_s=3600.0)
    ended: list[int] = []
    recorder = Recorder(lambda dropped: Disk(tmp_path / "log", dropped, ended), limits, LOG)
    for part in range(3):
        record(recorder, range(part * 100, part * 100 + 50))
        recorder.end_part()
        wait_until(lambda: len(ended) == part + 1)  # noqa: B023
    recorder.end_part()  # nothing has been added
    recorder.close()
    assert ended == [0, 1, 2]
    for number, path in enumerate(sorted(tmp_path.glob("log/*.mcap"))):
        with open_log(path) as log:
            assert log.is_complete
            assert [m.sequence for m in log.messages()] == list(range(number * 100, number * 100 + 50))


class Clock:
    """The machine's clock, set by the test."""

    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


def test_chunk_is_due_a_fixed_time_after_its_first_message() -> None:
    clock = Clock()
    queue = ChunkQueue(BufferLimits(1 << 20, 1 << 20, close_after_s=2.0), clock)
    queue.add(1, 1, 1, b"first")
    clock.now_ns = 1_999_999_999
    assert queue.take(until_ns=0) is None
    queue.add(1, 2, 2, b"second")
    clock.now_ns = 2_000_000_000
    chunk = queue.take(until_ns=None)
    assert chunk is not None and chunk.messages == 2
    assert queue.take(until_ns=0) is None
