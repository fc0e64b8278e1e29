"""Recordings are read by other programs unchanged, and stay complete in spite of disk errors."""

import json
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from robbie_mp.logs.recording.chunk import Compression
from robbie_mp.logs.recording.format import ChannelKey, RunMetadata, counts_from_metadata, part_path
from robbie_mp.logs.recording.info import describe
from robbie_mp.logs.recording.log_writer import Split
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import LaserScan, Odometry
from tests.logs.recording._support.recording import (
    CHANNELS,
    START_NS,
    STEP_NS,
    as_others_read,
    chunk_of,
    message,
    writer,
)


@pytest.mark.parametrize("compression", Compression)
def test_mcap_and_rosbags_read_every_message_unchanged(tmp_path: Path, compression: Compression) -> None:
    log = writer(tmp_path / "log", compression)
    for first in (0, 30, 60):
        log.write(chunk_of(range(first, first + 30)), CHANNELS)
    log.close()
    path = part_path(tmp_path / "log", 0)
    found = as_others_read(path)
    assert [sequence for _, sequence, _, _ in found] == list(range(90))
    for topic, sequence, time_ns, read in found:
        channel, written = message(sequence)
        assert (topic, time_ns) == (
            ("/front", "/odometry", "/front")[channel - 1],
            START_NS + sequence * STEP_NS,
        )
        assert read.header.stamp.sec == written.header.stamp.sec
        if channel == 2:
            assert isinstance(written, Odometry)
            assert read.child_frame_id == written.child_frame_id
        else:
            assert isinstance(written, LaserScan)
            assert list(read.ranges) == written.ranges.tolist()
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
        data = [bytes(raw) for connection, _, raw in bag.messages()]
    assert data == [message(number)[1].encode() for number in range(90)]


@pytest.mark.filterwarnings("ignore:start_time is deprecated")
def test_summary_agrees_with_the_library_mcap(tmp_path: Path) -> None:
    log = writer(tmp_path / "log", Compression.ZSTD)
    log.write(chunk_of(range(30)), CHANNELS)
    log.write(chunk_of(range(30, 50)), CHANNELS)
    log.close()
    with part_path(tmp_path / "log", 0).open("rb") as file:
        summary = make_reader(file).get_summary()
        file.seek(0)
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
        names = [type(record).__name__ for record in records]
        assert names[:3] == ["Header", "Metadata", "Chunk"]
        assert summary is not None and summary.statistics is not None
        statistics = summary.statistics
        assert (statistics.message_count, statistics.chunk_count, statistics.channel_count) == (50, 2, 3)
        assert statistics.channel_message_counts == {1: 17, 2: 17, 3: 16}
        assert statistics.metadata_count == names.count("Metadata") == len(summary.metadata_indexes)
        assert statistics.message_end_time == START_NS + 49 * STEP_NS
        file.seek(0)
        only = [m.sequence for *_, m in make_reader(file).iter_messages(start_time=START_NS + 45 * STEP_NS)]
        assert only == [45, 46, 47, 48, 49]
        assert {s.name for s in summary.schemas.values()} == {c.key.type_name for c in CHANNELS.values()}
        assert [c.metadata["robbie_sender"] for c in summary.channels.values()] == ["laser", "base", "spare"]


def test_parts_end_by_size_or_time_and_each_has_its_own_counts(tmp_path: Path) -> None:
    dropped: dict[ChannelKey, int] = {}
    small = writer(tmp_path / "small", split=Split(bytes=9000), dropped=dropped)
    for first in range(0, 60, 10):
        dropped[CHANNELS[2].key] = first  # ten more with each chunk
        small.write(chunk_of(range(first, first + 10)), CHANNELS)
    small.close()
    with open_log(tmp_path / "small") as log:
        assert len(log.parts) > 2
        assert max(part.size for part in log.parts) < 12_000
        assert [m.sequence for m in log.messages()] == list(range(60))
        counts = [counts_from_metadata(part.contents.metadata[-1].metadata) for part in log.parts]
        runs = [RunMetadata.from_metadata(part.contents.metadata[0].metadata) for part in log.parts]
    assert sum(count.recorded for part in counts for count in part.values()) == 60
    assert sum(count.dropped for part in counts for count in part.values()) == 50
    assert [run.part for run in runs] == list(range(len(runs)))
    assert runs[0].first_sequence == 0 < runs[1].first_sequence < runs[2].first_sequence

    brief = writer(tmp_path / "brief", split=Split(seconds=0.25))
    for first in range(0, 60, 10):
        brief.write(chunk_of(range(first, first + 10)), CHANNELS)
    brief.close()
    assert len(list((tmp_path / "brief").glob("*.mcap"))) == 3


def test_total_of_missing_messages_is_reported(tmp_path: Path) -> None:
    unknown = CHANNELS[1].key._replace(topic="rear", sender="")
    log = writer(tmp_path / "log", dropped={unknown: 7, CHANNELS[2].key: 2})
    log.write(chunk_of(range(10)), CHANNELS)
    log.close()
    with open_log(tmp_path / "log") as whole:
        told = {(one.channel.topic, one.messages): one.dropped for one in describe(whole).channels}
    assert told == {("front", 4): 0, ("", 3): 2, ("front", 3): 0, ("rear", 0): 7}


def test_continued_recording_gets_further_parts(tmp_path: Path) -> None:
    for first in (0, 10):
        log = writer(tmp_path / "log")
        log.write(chunk_of(range(first, first + 10)), CHANNELS)
        log.close()
    with open_log(tmp_path / "log") as both:
        assert [m.sequence for m in both.messages()] == list(range(20))


def test_recording_without_messages_leaves_nothing(tmp_path: Path) -> None:
    writer(tmp_path / "log").close()
    assert not list(tmp_path.iterdir())


@contextmanager
def files_of_at_most(limit: int) -> Iterator[None]:
    """Have the kernel refuse to let files grow beyond a size: one write is cut short, the next one fails."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_part_with_a_cut_chunk_ends_before_it_and_the_next_part_continues(
    tmp_path: Path,
) -> None:
    log = writer(tmp_path / "log")
    log.write(chunk_of(range(10)), CHANNELS)
    size = part_path(tmp_path / "log", 0).stat().st_size
    refused = chunk_of(range(10, 110))
    with files_of_at_most(size + 12_000), pytest.raises(OSError):
        log.write(refused, CHANNELS)
    log.write(refused, CHANNELS)
    log.close()
    with open_log(tmp_path / "log") as whole:
        assert len(whole.parts) == 2
        assert whole.is_complete, whole.damage  # there was room for the summary
        assert [m.sequence for m in whole.messages()] == list(range(110))
    assert [found[1] for found in as_others_read(part_path(tmp_path / "log", 0))] == list(range(10))


def test_part_without_room_for_its_summary_is_readable_to_its_last_chunk(tmp_path: Path) -> None:
    log = writer(tmp_path / "log")
    log.write(chunk_of(range(10)), CHANNELS)
    size = part_path(tmp_path / "log", 0).stat().st_size
    with files_of_at_most(size + 10), pytest.raises(OSError):
        log.write(chunk_of(range(10, 60)), CHANNELS)
    assert part_path(tmp_path / "log", 0).stat().st_size == size
    with open_log(tmp_path / "log") as whole:
        assert [m.sequence for m in whole.messages()] == list(range(10))
    with files_of_at_most(50), pytest.raises(OSError):
        log.write(chunk_of(range(10, 60)), CHANNELS)
    assert [path.name for path in (tmp_path / "log").iterdir()] == ["log_0000.mcap"]
    log.close()


def test_only_the_oldest_parts_of_recordings_are_removed(tmp_path: Path) -> None:
    root = tmp_path / "logs"
    for name in ("first", "second"):
        log = writer(root / name)
        log.write(chunk_of(range(30)), CHANNELS)
        log.close()
    size = part_path(root / "first", 0).stat().st_size
    busy = writer(root / "busy")
    busy.write(chunk_of(range(30)), CHANNELS)  # another one, being written
    (root / "second" / "notes.mcap").write_bytes(bytes(size))
    foreign = root / "import" / "import_0000.mcap"
    foreign.parent.mkdir()
    foreign.write_bytes(part_path(root / "first", 0).read_bytes().replace(b"robbie-mp", b"rosbag2  "))

    log = writer(root / "new", split=Split(bytes=size), budget=4 * size)
    log.write(chunk_of(range(30)), CHANNELS)
    assert not (root / "first").exists()
    assert part_path(root / "second", 0).exists()
    for _ in range(5):
        log.write(chunk_of(range(30)), CHANNELS)
    log.close()
    busy.close()
    assert not part_path(root / "second", 0).exists()
    assert (root / "second" / "notes.mcap").exists()
    assert foreign.exists()
    assert part_path(root / "busy", 0).exists()
    parts = sorted(path.name for path in (root / "new").iterdir())
    assert parts[-1] == "new_0005.mcap"
    assert "new_0000.mcap" not in parts
    assert json.dumps(parts).count("new_") + log.removed == 6 + 2
