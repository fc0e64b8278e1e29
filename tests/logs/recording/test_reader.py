"""A log is read in file order, from a given place, as far as it is intact."""

import errno
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from robbie_mp.logs.recording import part
from robbie_mp.logs.recording.contents import MessageBlock
from robbie_mp.logs.recording.decoding import LogDecoder
from robbie_mp.logs.recording.errors import LogUnreadable, NotALog
from robbie_mp.logs.recording.limits import ReadLimits
from robbie_mp.logs.recording.reader import Log, open_log
from robbie_mp.messages import LaserScan
from tests.logs.recording._support.logs import START_NS, STEP_NS, LogFile, scan, traffic, write_log
from tests.messages._support.rosbags_bridge import assert_same

FORMS: dict[str, dict[str, Any]] = {
    "plain": {},
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "without a summary": {
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
    "without message indexes": {"index_types": IndexType.CHUNK | IndexType.METADATA},
    "without an index": {"index_types": IndexType.NONE},
    "without channels in its summary": {"repeat_channels": False},
    "without chunks": {"use_chunking": False},
    "without checksums": {"enable_crcs": False},
}


def told(log: Log) -> list[tuple[str, str, str, int, int, bytes]]:
    return [
        (m.channel.type_name, m.channel.topic, m.channel.sender, m.sequence, m.time_ns, m.data)
        for m in log.messages()
    ]


def expected(count: int) -> list[tuple[str, str, str, int, int, bytes]]:
    return [
        (message.type_name, topic, sender, number, time_ns, message.encode())
        for number, (message, topic, sender, time_ns) in enumerate(traffic(count), start=1)
    ]


@pytest.mark.parametrize("form", FORMS)
def test_messages_are_in_file_order_for_every_form_of_file(tmp_path: Path, form: str) -> None:
    with open_log(write_log(tmp_path / "a.mcap", 30, **FORMS[form])) as log:
        assert told(log) == expected(30)
        assert log.is_complete and not log.damage
        assert (log.start_ns, log.end_ns) == (START_NS, START_NS + 29 * STEP_NS)
        assert list(log.counts.values()) == [10, 10, 10]
        assert [channel.id for channel in log.channels] == [0, 1, 2]
        assert log.metadata("robbie_run")[0]["run_id"] == "0123abcd"


def test_file_order_is_kept_even_if_times_go_back(tmp_path: Path) -> None:
    times = [START_NS + offset for offset in (5, 3, 4, 1, 2)]
    with LogFile(tmp_path / "a.mcap", chunk_size=1) as file:
        for time_ns in times:
            file.add(scan(1), time_ns=time_ns)
    with open_log(tmp_path / "a.mcap") as log:
        assert [message.time_ns for message in log.messages()] == times
        some = [message.time_ns for message in log.messages(START_NS + 2, START_NS + 5)]
    assert some == times[1:3] + times[4:]


@pytest.mark.parametrize("form", ["plain", "without message indexes", "without chunks"])
def test_selected_channels_and_times_agree_with_the_library_mcap(tmp_path: Path, form: str) -> None:
    path = write_log(tmp_path / "a.mcap", 60, **FORMS[form])
    start_ns, end_ns = START_NS + 7 * STEP_NS, START_NS + 34 * STEP_NS
    with path.open("rb") as file:
        theirs = make_reader(file).iter_messages(
            topics=["/odom"], starting_at=start_ns, ending_before=end_ns, log_time_order=False
        )
        sequences = [message.sequence for _, _, message in theirs]
    with open_log(path) as log:
        wanted = [channel for channel in log.channels if channel.topic == "odom"]
        assert [m.sequence for m in log.messages(start_ns, end_ns, wanted)] == sequences != []
        assert list(log.messages(channels=[])) == []


def test_folder_of_parts_is_one_log(tmp_path: Path) -> None:
    for number, times in ((10000, [3]), (9999, [1, 2])):
        with LogFile(tmp_path / f"run_{number:04}.mcap") as file:
            for time in times:
                file.add(scan(time), "laser", time_ns=START_NS + time)
            file.add(scan(0), f"only in {number}", time_ns=START_NS)
    with open_log(tmp_path) as log:
        assert [channel.topic for channel in log.channels] == ["laser", "only in 9999", "only in 10000"]
        (laser, *_) = log.channels
        assert [m.time_ns - START_NS for m in log.messages(channels=[laser])] == [1, 2, 3]
        assert log.counts[laser] == 3
        assert (log.start_ns, log.end_ns) == (START_NS, START_NS + 3)


def test_schemas_are_those_of_the_log(tmp_path: Path) -> None:
    with open_log(write_log(tmp_path / "a.mcap")) as log:
        channel = log.channels[0]
        assert (channel.type_name, channel.version) == ("sensor_msgs/msg/LaserScan", LaserScan.version)
        assert channel.schema and channel.schema.startswith("std_msgs/Header header\nfloat32 angle_min\n")


def test_mcap_ros2_support_and_rosbags_read_the_same_fields(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap")
    with open_log(path) as log:
        ours = list(map(LogDecoder().decode, log.messages()))
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        by_mcap = [found.decoded_message for found in reader.iter_decoded_messages(log_time_order=False)]
    with AnyReader([path]) as bag:
        by_rosbags = [bag.deserialize(data, connection.msgtype) for connection, _, data in bag.messages()]
    for mine, *theirs in zip(ours, by_mcap, by_rosbags, strict=True):
        for its in theirs:
            assert_same(mine, its)


def test_topic_and_version_of_a_foreign_log_are_derived(tmp_path: Path) -> None:
    with LogFile(tmp_path / "a.mcap") as file:
        for topic, name in (("/t", "tf2_msgs/msg/TFMessage"), ("/u", "team_msgs/Unknown")):
            schema_id = file.writer.register_schema(name, "ros2msg", b"float64 wholly_other")
            channel = file.writer.register_channel(topic, "cdr", schema_id)
            file.add_bytes(channel, b"\0\1\0\0" + bytes(8), START_NS)
        bare = file.writer.register_channel("/json", "json", 0)
        file.add_bytes(bare, b"{}", START_NS)
    with open_log(tmp_path / "a.mcap") as log:
        seen = [(c.type_name, c.version, c.topic, c.sender, c.encoding) for c in log.channels]
    assert seen == [
        ("tf2_msgs/msg/TFMessage", 1, "t", "", "cdr"),
        ("team_msgs/msg/Unknown", 1, "u", "", "cdr"),
        ("", 1, "json", "", "json"),
    ]


@pytest.mark.parametrize("form", ["zstd", "without chunks"])
def test_complete_chunks_of_a_file_cut_anywhere_are_read(tmp_path: Path, form: str) -> None:
    whole = write_log(tmp_path / "a.mcap", 9, **FORMS[form]).read_bytes()
    cut, messages, last = tmp_path / "cut.mcap", expected(9), 0
    for size in range(1, len(whole), 61):
        cut.write_bytes(whole[:size])
        with open_log(cut) as log:
            found = told(log)
            assert not log.is_complete
        assert found == messages[: len(found)]
        assert len(found) >= last
        last = len(found)
    assert last == len(messages)


def test_damaged_chunk_is_skipped_and_later_ones_are_found(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", 30)
    whole = path.read_bytes()
    with open_log(path) as log:
        frames = [block.frame for block in log.parts[0].contents.blocks]
    length, middle = frames[3].start - 8, frames[3].start + 300
    for at, has_summary in ((length, False), (middle, False), (middle, True)):
        damaged = whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :]
        path.write_bytes(damaged if has_summary else damaged[:-1])
        with open_log(path) as log:
            found = told(log)
            assert not log.is_complete and str(path) in log.damage[0]
        assert set(found) < set(expected(30)) and found[-1] == expected(30)[-1]
        assert 30 > len(found) > 20


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_reading_a_file_with_any_changed_bytes_ends_without_other_errors(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("logs")
    form = data.draw(st.sampled_from(["plain", "zstd", "lz4", "without chunks", "without checksums"]))
    content = bytearray(write_log(folder / "a.mcap", 9, **FORMS[form]).read_bytes())
    for at, value in data.draw(
        st.lists(st.tuples(st.integers(8, len(content) - 1), st.integers(0, 255)), max_size=4)
    ):
        content[at] = value
    (folder / "a.mcap").write_bytes(content)
    with open_log(folder / "a.mcap") as log:
        messages = list(log.messages())
        list(log.messages(START_NS, START_NS + STEP_NS, log.channels[:1]))
    assert len(messages) <= 9


def test_seek_in_an_hour_of_log_does_not_read_all_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    with LogFile(path, chunk_size=1) as file:
        for second in range(3600):
            file.add(scan(second), time_ns=START_NS + second * 10**9)
    with open_log(path) as log:
        reads: list[MessageBlock] = []
        read = MessageBlock.read

        def read_and_count(block: MessageBlock, file: BinaryIO, limits: ReadLimits) -> bytes:
            reads.append(block)
            return read(block, file, limits)

        monkeypatch.setattr(MessageBlock, "read", read_and_count)
        first = next(log.messages(start_ns=START_NS + 1800 * 10**9))
    assert first.time_ns == START_NS + 1800 * 10**9
    assert len(reads) == 1


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"", "is empty"),
        (b"no log at all", "is no MCAP file"),
        (b"SQLite format 3\0...", "is no MCAP file, but a SQLite database, perhaps a ROS 2 bag"),
        (b"#ROSBAG V2.0\n", "is no MCAP file, but a ROS 1 bag: see `robbie import-rosbag`"),
    ],
)
def test_file_that_is_not_a_log_is_reported(tmp_path: Path, content: bytes, what: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(NotALog, match=what):
        open_log(path)


def test_part_that_was_only_begun_does_not_hide_the_others(tmp_path: Path) -> None:
    write_log(tmp_path / "log_0000.mcap")
    (tmp_path / "log_0001.mcap").touch()
    with open_log(tmp_path) as log:
        assert log.is_complete and sum(log.counts.values()) == 30
    (tmp_path / "log_0000.mcap").unlink()
    with pytest.raises(NotALog, match="empty"):
        open_log(tmp_path)


def test_folder_without_a_log_or_with_several_is_reported(tmp_path: Path) -> None:
    with pytest.raises(NotALog, match="has no parts of a log"):
        open_log(tmp_path)
    write_log(tmp_path / "a.mcap")
    with open_log(tmp_path) as log:
        assert len(log.parts) == 1
    write_log(tmp_path / "b_0001.mcap")
    with pytest.raises(NotALog, match=r"has several logs \(a, b\); name a file"):
        open_log(tmp_path)
    with pytest.raises(LogUnreadable, match="No such file"):
        open_log(tmp_path / "none.mcap")
    with pytest.raises(LogUnreadable, match="cannot be read: Invalid argument"):
        open_log(Path("/proc/self/mem"))  # which fails as a broken disk does


class WornOut:
    """A file on a disk that cannot read some of its blocks any more."""

    def __init__(self, file: BinaryIO, bad: range) -> None:
        self._file, self._bad = file, bad

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def read(self, length: int = -1) -> bytes:
        at = self._file.tell()
        data = self._file.read(length)
        if at < self._bad.stop and self._bad.start < at + len(data):
            raise OSError(errno.EIO, "Input/output error")
        return data


def test_blocks_that_the_disk_cannot_read_are_damage_and_the_rest_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_log(tmp_path / "a.mcap", 30, chunk_size=600)
    bad = range(2000, 2001)
    monkeypatch.setattr(part, "open_regular", lambda file: WornOut(file.open("rb"), bad))
    with open_log(path) as log:
        read = told(log)
        assert 0 < len(read) < 30 and set(map(str, read)) < set(map(str, expected(30)))
        assert len(log.damage) == 1 and "Input/output error" in log.damage[0]
    bad = range(0, 1 << 30)
    with pytest.raises(LogUnreadable, match="cannot be read: Input/output error"):
        open_log(path)
