"""Log records reach the supervisor complete, never block a child, and are not trusted."""

import json
import logging
import os
import select
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.run.profile.model import TraceSettings
from robbie_mp.run.supervisor.event_loop import EventLoop
from robbie_mp.run.supervisor.output import ChildOutput, OutputStore
from robbie_mp.run.supervisor.streams import RecordStream
from robbie_mp.run.trace.channel import LINE_BYTES, ChannelHandler, open_channel, parse_line
from robbie_mp.run.trace.entry import Entry, EntryNumbers
from robbie_mp.run.trace.kinds import Kind, follow_level, write_recorded


class Pair:
    """A child's logger and the supervisor's end of its channel, in one process."""

    def __init__(self, folder: Path):
        self.entries: list[Entry] = []
        self.store = OutputStore(folder, self.entries.append, TraceSettings(burst_lines=100_000))
        self.output: ChildOutput = self.store.child("laser", [Kind.ERROR, Kind.WARNING, Kind.INFO])
        self.loop = EventLoop(time.monotonic)
        ours, self.theirs = open_channel()
        self.stream = RecordStream(ours, self.output, self.loop)
        self.handler = ChannelHandler(self.theirs)
        self.log = logging.Logger("laser.driver")
        self.log.addHandler(self.handler)

    def read(self) -> list[Entry]:
        """Read all there is."""
        while select.select([self.stream._fd], [], [], 0.0)[0]:
            self.loop.turn(0.0)
        return self.entries

    def close(self) -> None:
        if self.theirs >= 0:
            os.close(self.theirs)
        self.stream.finish()
        self.output.close()
        self.store.close()
        self.loop.close()


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[Pair]:
    made = Pair(tmp_path)
    yield made
    made.close()


def test_record_arrives_complete_with_its_traceback(pair: Pair) -> None:
    pair.output.begin(3)
    try:
        _ = 1 / 0
    except ZeroDivisionError:
        pair.log.exception("cannot divide\n%s by %d", "one", 0)
    [entry] = pair.read()
    assert entry.text == "cannot divide\none by 0"
    assert (entry.kind, entry.level, entry.logger, entry.module) == (
        Kind.ERROR,
        "ERROR",
        "laser.driver",
        "laser",
    )
    assert (entry.incarnation, entry.stream, entry.thread) == (3, "log", "")
    assert entry.where.startswith("test_channel.py:")
    assert entry.traceback.splitlines()[-1] == "ZeroDivisionError: division by zero"
    assert abs(entry.time_s - time.time()) < 10
    assert pair.output.last_lines[-1] == "ZeroDivisionError: division by zero"


def test_child_never_blocks_counts_losses_and_has_room_for_errors(pair: Pair) -> None:
    sent = 10_000
    for number in range(sent):
        pair.log.info("%d %s", number, "x" * 100)
    assert pair.handler.dropped > 0
    pair.log.error("the last words")
    assert pair.handler.dropped == 0, "the error did not find room"
    entries = pair.read()
    assert [entry.text for entry in entries if entry.stream == "log"][-1] == "the last words"
    assert [entry.number for entry in entries] == sorted(entry.number for entry in entries)
    kept = [entry for entry in entries if entry.kind is Kind.INFO]
    assert len(kept) + pair.output.dropped == sent
    assert [entry.text.split()[0] for entry in kept] == [str(number) for number in range(len(kept))]
    assert any(entry.text.startswith(f"{sent - len(kept)} lines dropped") for entry in entries)


def test_records_dropped_last_are_reported_at_exit(pair: Pair) -> None:
    pair.handler.dropped = 7
    pair.handler.close()
    pair.read()
    assert pair.output.dropped == 7


def test_long_record_is_cut_and_marked_as_cut(pair: Pair) -> None:
    pair.log.error("\N{GRINNING FACE}" * 100_000 + "end")
    pair.log.error("short")
    long, short = pair.read()
    assert long.text.endswith("characters cut)")
    assert len(long.to_line()) < 4 * LINE_BYTES
    assert short.text == "short"


def test_record_with_wrong_arguments_is_one_line_that_names_the_call(pair: Pair) -> None:
    pair.log.info("value %d", "x")
    [entry] = pair.read()
    assert f"a log call at {__file__}:" in entry.text
    assert "do not match: 'value %d': TypeError: %d format: " in entry.text


def test_kinds_that_are_not_recorded_do_not_count_as_lost(pair: Pair) -> None:
    pair.log.debug("details")
    pair.log.info("news")
    assert [entry.text for entry in pair.read()] == ["news"]
    assert pair.output.dropped == 0


def test_child_logs_at_the_level_that_is_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = logging.Logger("root")
    monkeypatch.setattr(logging, "getLogger", lambda: root)
    before = signal.getsignal(signal.SIGURG)
    try:
        follow_level(tmp_path, "laser")
        assert root.level == logging.INFO, "nobody has said anything"
        write_recorded(tmp_path, {"laser": [Kind.SYSTEM]})
        os.kill(os.getpid(), signal.SIGURG)
        assert root.level == logging.DEBUG
    finally:
        signal.signal(signal.SIGURG, before)


def test_escape_sequences_and_incomplete_characters_are_escaped(pair: Pair) -> None:
    pair.log.info("\x1b[2J\x00 \ud800 \u202e </script>-->")
    [entry] = pair.read()
    assert entry.text == "\\x1b[2J\\x00 \\ud800 \\u202e </script>-->"
    assert entry.to_line().isascii()
    assert not {b"<", b">"} & {bytes([byte]) for byte in entry.to_line()}
    assert Entry.from_line(entry.to_line()) == entry


@pytest.mark.parametrize(
    "packet",
    [
        b"no json",
        b"[" * 20_000,
        b'{"text": 1, "level": 1e999, "time_s": NaN, "dropped": -5}',
        b'{"text": "a", "time_s": 1%s, "level": "high"}' % (b"0" * 4000),
        b'{"level": true}',
        b"\xff\xfe",
        b"x" * (LINE_BYTES + 100),
    ],
)
def test_hostile_packet_is_at_most_an_entry(pair: Pair, packet: bytes) -> None:
    os.write(pair.theirs, packet + b"\n")
    pair.log.info("still here")
    entries = pair.read()
    assert entries[-1].text == "still here"
    assert len(entries) == 2
    assert Entry.from_line(entries[0].to_line()) == entries[0]


@pytest.mark.slow
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.integers() | st.text(), st.lists))
def test_any_json_is_a_valid_packet_or_ignored(value: object) -> None:
    keys = ("text", "level", "time_s", "logger", "dropped", "traceback", "thread", "where", "level_name")
    for key in keys:
        packet = json.dumps({"text": "x", key: value}).encode()
        if parsed := parse_line(packet, 1e9):
            assert parsed.dropped >= 0
            assert parsed.record is None or abs(parsed.record.time_s - 1e9) < 3601


def test_flood_of_records_is_bounded_and_its_end_is_kept(tmp_path: Path) -> None:
    kept: list[Entry] = []
    store = OutputStore(tmp_path, kept.append, TraceSettings(lines_per_s=0.0, burst_lines=10))
    output = store.child("laser")
    packets = [json.dumps({"text": f"line {number}", "level": 20}).encode() for number in range(100)]
    assert output.add_records(packets[:5])
    assert not output.add_records(packets)
    assert output.add_records([b'{"text": "why", "level": 40}']), "errors have a rate of their own"
    output.close()
    store.close()
    assert [entry.text for entry in kept if entry.stream == "log"] == [
        *(f"line {number}" for number in (*range(5), *range(5))),
        "why",
    ]
    assert output.dropped == 95
    assert output.last_lines[-2:] == ("line 99", "why")


def test_long_records_count_as_often_as_printed_lines_of_their_length(tmp_path: Path) -> None:
    kept: list[Entry] = []
    limits = TraceSettings(lines_per_s=0.0, burst_lines=10, line_characters=100)
    store = OutputStore(tmp_path, kept.append, limits)
    output = store.child("laser")
    assert not output.add_records([json.dumps({"text": "x" * 350, "level": 20}).encode()] * 5)
    output.close()
    store.close()
    assert [entry.stream for entry in kept].count("log") == 2
    assert output.dropped == 3


def test_endless_line_takes_no_more_memory_than_a_line(pair: Pair) -> None:
    for _ in range(20):
        os.write(pair.theirs, b"x" * LINE_BYTES)
        pair.read()
    assert len(pair.stream._partial) <= 2 * LINE_BYTES
    assert pair.output.lines >= 10


def test_numbers_increase_even_if_the_clock_is_set_back() -> None:
    times = iter([100.0, 50.0, 50.0, 200.0])
    numbers = EntryNumbers(lambda: next(times))
    assert [numbers.next() for _ in range(4)] == [100_000_000, 100_000_001, 100_000_002, 200_000_000]


def test_partly_written_line_is_finished_first(pair: Pair) -> None:
    long = b'{"level":40,"text":"%s"}\n' % (b"x" * 20_000)
    while pair.handler.send(long):
        pass
    assert pair.handler._rest
    first = len(pair.read())
    pair.log.info("after that")
    texts = [entry.text for entry in pair.read() if entry.stream == "log"]
    assert texts[: first + 1] == ["x" * 20_000] * (first + 1)
    assert texts[-1] == "after that"
    assert pair.output.dropped == 1


def test_incomplete_record_of_a_killed_child_is_shown(pair: Pair) -> None:
    os.write(pair.theirs, b'{"level":40,"text":"the la')
    os.close(pair.theirs)
    pair.theirs = -1
    pair.stream.finish()
    assert "the la" in pair.entries[0].text


def test_record_without_a_reader_is_counted(pair: Pair) -> None:
    pair.stream.finish()
    pair.log.error("into nowhere")
    assert pair.handler.dropped == 1
