"""The newest latched messages: at the beginning of each part of a log, of a cut, and of a playback."""

import logging
from collections.abc import Collection, Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from robbie_mp.cli import main
from robbie_mp.logs.playback.tape import Tape
from robbie_mp.logs.recording.chunk import Chunk
from robbie_mp.logs.recording.chunk_queue import BufferLimits
from robbie_mp.logs.recording.format import ChannelKey, counts_from_metadata
from robbie_mp.logs.recording.info import describe
from robbie_mp.logs.recording.log_writer import LogWriter, Split
from robbie_mp.logs.recording.newest import KeepLimits, NewestMessages
from robbie_mp.logs.recording.part_writer import RecordedChannel
from robbie_mp.logs.recording.reader import Log, LoggedMessage, open_log
from robbie_mp.logs.recording.recorder import Recorder
from robbie_mp.messages import Header, Odometry, TFMessage, Transform, TransformStamped, schema_text
from tests.logs.playback._support.recorder import SECOND_NS, PlayerRig
from tests.logs.recording._support import logs
from tests.logs.recording._support.logs import LogFile
from tests.logs.recording._support.recording import CHANNELS, START_NS, STEP_NS, message, writer

MAP_KEY = ChannelKey(Odometry.type_name, 1, "map", "mapper")
SCHEMA = schema_text(Odometry)
MAP = RecordedChannel(4, MAP_KEY, SCHEMA, carried_id=5)
CARRIED_MAP = RecordedChannel(5, MAP_KEY, SCHEMA, is_carried=True)
ALL_CHANNELS = CHANNELS | {4: MAP, 5: CARRIED_MAP}
MAPS = (3, 11)
"""Numbers of the messages that are maps; all others are of channels that are not latched."""
COUNT = 30
PART = 10
"""Messages in a part."""


def map_of(number: int) -> bytes:
    return Odometry(child_frame_id=f"map {number}").encode()


def at_ns(number: int) -> int:
    return START_NS + number * STEP_NS


def chunk_of(numbers: Collection[int], maps: Collection[int] = MAPS) -> Chunk:
    chunk = Chunk(0)
    for number in numbers:
        channel, content = message(number)
        if number in maps:
            chunk.add(MAP.id, number, at_ns(number), map_of(number))
        else:
            chunk.add(channel, number, at_ns(number), content.encode())
    return chunk


def record(made: LogWriter, maps: Collection[int] = MAPS) -> Path:
    for first in range(0, COUNT, 5):
        made.write(chunk_of(range(first, first + 5), maps), ALL_CHANNELS)
    made.close()
    return made.folder


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Three parts of 10 messages; messages 3 and 11 are maps on a latched topic."""
    return record(writer(tmp_path / "monday", split=Split(seconds=0.095)))


@pytest.fixture
def log(recording: Path) -> Iterator[Log]:
    with open_log(recording) as opened:
        yield opened


def newest(log: Log, before_ns: int) -> list[tuple[int, int, bytes]]:
    """Sequence, time and content of the newest latched messages."""
    return [(one.sequence, one.time_ns, one.data) for one in log.newest_latched(before_ns)]


def expected(number: int) -> list[tuple[int, int, bytes]]:
    return [(number, at_ns(number), map_of(number))]


def test_each_part_begins_with_the_newest_map_before_it_for_every_reader(recording: Path) -> None:
    first_messages = []
    for path in sorted(recording.glob("*.mcap")):
        with path.open("rb") as file:
            _, channel, first = next(make_reader(file).iter_messages(log_time_order=False))
            first_messages.append((channel.topic, first.sequence, first.log_time, first.publish_time))
    assert first_messages[1:] == [
        ("/map", 3, at_ns(10), at_ns(3)),  # as if recorded when the part begins, published before
        ("/map", 11, at_ns(20), at_ns(11)),
    ]
    assert first_messages[0][1] == 0


def test_copies_are_not_counted_as_messages(log: Log) -> None:
    assert [one.sequence for one in log.messages()] == list(range(COUNT))
    assert log.message_count == sum(log.counts.values()) == COUNT
    assert (log.start_ns, log.end_ns) == (at_ns(0), at_ns(COUNT - 1))
    counts = [counts_from_metadata(record)[MAP_KEY].recorded for record in log.metadata("robbie_counts")[:2]]
    assert counts == [1, 1]
    assert MAP_KEY not in counts_from_metadata(log.metadata("robbie_counts")[2])
    told = {one.channel.topic: one for one in describe(log).channels}
    assert (told["map"].messages, told["map"].carried, told["map"].channel.is_latched) == (2, 2, True)
    assert (told["front"].carried, told["front"].channel.is_latched) == (0, False)


@pytest.mark.parametrize(
    ("moment", "number"), [(4, 3), (10, 3), (11, 3), (12, 11), (19, 11), (20, 11), (29, 11), (1000, 11)]
)
def test_newest_map_is_found_at_any_time(log: Log, moment: int, number: int) -> None:
    assert newest(log, at_ns(moment)) == expected(number)


@pytest.mark.parametrize("moment", [-5, 0, 3])
def test_before_the_first_map_there_is_none(log: Log, moment: int) -> None:
    assert newest(log, at_ns(moment)) == []


@pytest.mark.parametrize("moment", [0, 20, 25])
def test_single_part_knows_what_was_newest_before_it(recording: Path, moment: int) -> None:
    with open_log(recording / "monday_0002.mcap") as log:
        assert newest(log, at_ns(moment)) == expected(11)
        assert log.message_count == PART


def test_log_without_an_end_knows_what_was_newest(recording: Path) -> None:
    path = recording / "monday_0002.mcap"
    path.write_bytes(path.read_bytes()[:-100])
    with open_log(path) as log:
        assert not log.is_complete
        assert newest(log, log.start_ns) == expected(11)


def test_message_from_before_the_recording_begins_it_and_later_parts(tmp_path: Path) -> None:
    made = writer(tmp_path / "monday", split=Split(seconds=0.095))
    before = (1 << 32) - 1  # logs have sequence numbers modulo 2^32
    made.newest.keep(MAP, before, at_ns(-7), b"\0\1\0\0old")
    with open_log(record(made, maps=())) as log:
        for moment in (0, 10, 29):
            assert newest(log, at_ns(moment)) == [(before, at_ns(-7), b"\0\1\0\0old")]
        assert len(log.parts) == 3
        assert log.message_count == COUNT


def test_map_larger_than_a_part_does_not_begin_a_part_for_each_chunk(tmp_path: Path) -> None:
    parts = {}
    for name, size in (("small", 4), ("large", 100_000)):
        made = writer(tmp_path / name, split=Split(bytes=10_000))
        made.newest.keep(MAP, (1 << 32) - 1, at_ns(-7), bytes(size))
        record(made, maps=())
        parts[name] = made.parts
    assert parts["large"] == parts["small"] > 1


class Messages:
    """A recorder whose writer the test can inspect."""

    def __init__(self, folder: Path):
        limits = BufferLimits(1 << 10, 1 << 12, close_after_s=0.01)
        log = logging.getLogger(__name__)
        self.recorder = Recorder(lambda _dropped: writer(folder), limits, log)
        self.map = self.recorder.channel(MAP_KEY, SCHEMA, is_latched=True)
        self.other = self.recorder.channel(CHANNELS[2].key, SCHEMA)


def test_recording_in_which_nothing_happens_still_has_the_latched_messages(tmp_path: Path) -> None:
    made = Messages(tmp_path / "quiet")
    made.recorder.carry(made.map, 7, at_ns(7), map_of(7))
    made.recorder.carry(made.map, 6, at_ns(6), map_of(6))
    made.recorder.close()
    with open_log(tmp_path / "quiet") as log:
        assert newest(log, log.start_ns) == expected(7)
        assert log.message_count == 0
    assert sum(recorded for recorded, _ in made.recorder.counts().values()) == 0


def test_newest_messages_are_bounded_and_the_oldest_is_left_out() -> None:
    kept = NewestMessages(KeepLimits(messages=2, bytes=100))
    channels = [RecordedChannel(n, MAP_KEY._replace(topic=f"{n}"), "", carried_id=n + 10) for n in range(4)]
    for number, size in enumerate([10, 20, 50, 60]):
        kept.keep(channels[number], number, number, bytes(size))
    (copies,) = kept.copies(0)
    assert list(copies.index) == [13]  # 50 and 60 bytes are too much together
    assert kept.left_out == 3


# -- cut, filter, merge ----------------------------------------------------------------------------


def edited(tmp_path: Path, *arguments: str) -> Log:
    target = tmp_path / f"{arguments[0]}.mcap"
    assert main(["recording", *arguments, "-o", str(target)]) == 0
    return open_log(target)


def test_cut_has_the_newest_map_from_before_marked_and_not_counted(recording: Path, tmp_path: Path) -> None:
    with edited(tmp_path, "cut", str(recording), "--from", "0.25", "--to", "0.28") as cut:
        assert newest(cut, cut.start_ns) == expected(11)
        assert [one.sequence for one in cut.messages()] == [25, 26, 27]
        assert (cut.start_ns, cut.message_count) == (at_ns(25), 3)
        counts = counts_from_metadata(cut.metadata("robbie_counts")[-1])
        assert sum(count.recorded for count in counts.values()) == 3
        assert cut.metadata("robbie_run")[0]["first_sequence"] == "25"


def test_filter_merge_and_a_second_cut_keep_what_was_newest(recording: Path, tmp_path: Path) -> None:
    part = recording / "monday_0002.mcap"
    with edited(tmp_path, "filter", str(part), "--topic", "map", "--topic", "front") as found:
        assert newest(found, found.start_ns) == expected(11)
        assert all(one.channel.topic == "front" for one in found.messages())
    with edited(tmp_path, "cut", str(tmp_path / "filter.mcap"), "--from", "0.05") as found:
        assert newest(found, found.start_ns) == expected(11)
    with edited(tmp_path, "merge", str(tmp_path / "cut.mcap"), str(recording)) as merged:
        assert newest(merged, merged.start_ns) == []
        assert newest(merged, at_ns(15)) == expected(11)


def test_cut_has_the_fixed_transforms_of_each_sender_though_none_is_latched(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    with LogFile(path) as old:
        for number, sender in enumerate(["red", "blue", "red", "blue", "red"]):
            frame = TransformStamped(
                header=Header(frame_id=sender), child_frame_id=f"{number}", transform=Transform()
            )
            old.add(TFMessage(transforms=[frame]), "tf_static", sender, time_ns=at_ns(number))
            old.add(TFMessage(transforms=[frame]), "tf", sender, time_ns=at_ns(number))
        old.add(Odometry(), "odom", "base", time_ns=at_ns(10))
    with edited(tmp_path, "cut", str(path), "--from", "0.05") as cut:
        carried = cut.newest_latched(cut.start_ns)
        assert [(one.channel.topic, one.channel.sender, one.time_ns) for one in carried] == [
            ("tf_static", "blue", at_ns(3)),
            ("tf_static", "red", at_ns(4)),
        ]
        assert [one.channel.topic for one in cut.messages()] == ["odom"]


def test_topics_that_rosbag2_recorded_as_transient_local_are_latched(tmp_path: Path) -> None:
    path = tmp_path / "ros.mcap"
    with LogFile(path) as made:
        schema = made.writer.register_schema(Odometry.type_name, "ros2msg", SCHEMA.encode())
        for topic, durability in (("/map", "1"), ("/plan", "transient_local"), ("/odom", "2")):
            quality = f"- history: 1\n  depth: 1\n  reliability: 1\n  durability: {durability}\n"
            channel = made.writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": quality})
            made.add_bytes(channel, Odometry().encode(), at_ns(0))
    with open_log(path) as log:
        assert [one.channel.topic for one in log.newest_latched(at_ns(1))] == ["map", "plan"]


# -- playback --------------------------------------------------------------------------------------


def test_playback_gives_the_newest_map_at_its_start_and_after_a_seek_in_either_direction(log: Log) -> None:
    rig = PlayerRig(log, 1.0)
    rig.run(0.145)
    assert rig.outlet.numbers == list(range(15))
    rig.player.control("seek", 0.25)
    rig.run(0.0, 1.0)
    assert rig.outlet.numbers[15:] == [11, 25]
    rig.player.control("seek", 0.05)
    rig.run(0.025)
    assert rig.outlet.numbers[17:] == [3, 5, 6, 7]
    assert rig.player.played == 15 + 1 + 3, "what is given again is not played"


def test_paused_playback_gives_the_map_before_any_tick_and_plays_nothing(recording: Path) -> None:
    with open_log(recording / "monday_0001.mcap") as log:
        rig = PlayerRig(log, None, paused=True, lockstep=True)
        rig.outlet.room = 0
        rig.run(1.0)
        assert rig.outlet.numbers == []
        rig.outlet.room = 1
        rig.run(1.0)
        assert rig.outlet.sent == [(3, at_ns(10))]
        assert (rig.player.played, rig.clock.now_ns()) == (0, at_ns(10))
        rig.player.control("step", 0)
        rig.run(1.0)
        assert rig.outlet.numbers == [3, 10]


def test_killed_playback_gives_each_latched_message_once(recording: Path) -> None:
    with open_log(recording / "monday_0001.mcap") as log:
        tape = Tape(log, log.channels, log.start_ns, log.end_ns)
        assert tape.gives == 1
        tape.take()
        again = Tape(log, log.channels, log.start_ns, log.end_ns)
        again.restore(tape.sought_ns, tape.taken)
        assert again.gives == 0
        assert isinstance(again.next, LoggedMessage)
        assert again.next.sequence == 10


def test_seek_to_a_latched_message_of_long_ago_reads_few_chunks(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    with LogFile(path, chunk_size=1000) as made:
        made.add(TFMessage(), "tf_static", "base", time_ns=logs.START_NS)
        for number in range(2000):
            made.add(Odometry(), "odom", "base", time_ns=logs.START_NS + number * SECOND_NS)
    with open_log(path) as log:
        read = []
        original = log.parts[0]._messages_of
        log.parts[0]._messages_of = lambda block: (read.append(block), original(block))[1]  # type: ignore[method-assign,func-returns-value]
        assert len(log.newest_latched(log.end_ns)) == 1
        assert len(read) == 1
