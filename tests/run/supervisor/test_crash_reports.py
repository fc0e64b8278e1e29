"""Which ends are crashes, and the evidence in a dead module's memory, with any contents."""

from array import array
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.board import Board
from robbie_mp.bus.transport.layout import Activity
from robbie_mp.bus.transport.records import Inbound
from robbie_mp.bus.transport.tables import CoreTables, TableSizes
from robbie_mp.bus.transport.words import Words, write_text
from robbie_mp.run.supervisor.crash import LastWordsReader
from robbie_mp.run.trace.crash import LastMessage, report_files
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import NEVER, Run, Scenario, animal

CAPACITY = 8
STOPPED = (zoo.works, zoo.ignores_sigterm, zoo.fails_in_teardown)
"""The others end by themselves."""
WORD = st.integers(0, 2**64 - 1)


@pytest.mark.parametrize(
    ("behaviour", "crashes"),
    [
        (zoo.works, 0),
        (zoo.ends_when_ready, 0),
        (zoo.ignores_sigterm, 0),  # and is killed: that is ours
        (zoo.fails_in_teardown, 1),
        (zoo.ends_at_once, 1),  # before it was ready
        (zoo.fails_when_ready, 1),
        (zoo.crashes, 1),
    ],
)
def test_unexpected_end_is_a_crash(
    tmp_path: Path, behaviour: Callable[[zoo.Animal], None], crashes: int
) -> None:
    run = Run(tmp_path, animal(behaviour, "child", restart=NEVER, stop_grace_s=0.1))

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.stop("seen enough")

    run.play(scenario() if behaviour in STOPPED else None)
    assert len(report_files(run.logs, "child")) == crashes
    assert len([entry for entry in run.lines if entry.crash_report]) == crashes


class Remains:
    """The memory of a dead module and its core."""

    def __init__(self) -> None:
        sizes = TableSizes(2, 3, 4, 5, 6)
        self.core: Words = words(sizes.words)
        tables = CoreTables.create(self.core, sizes)
        board = Board(words(layout.board_words(3)))
        board.create(["supervisor", "laser", "core"])
        self.out: Words = words(layout.out_words(16))
        self.into: Words = words(layout.IN_RING + CAPACITY * layout.RECORD_WORDS)
        self.reader = LastWordsReader(tables, board, CAPACITY)
        at = tables.channel(2)
        write_text(self.core, at + layout.CHANNEL_TYPE, layout.NAME_WORDS, "sensor_msgs/msg/LaserScan")
        write_text(self.core, at + layout.CHANNEL_TOPIC, layout.NAME_WORDS, "front")

    def take(self, kind: Inbound, sequence: int) -> None:
        """Have the module take one more record."""
        number = self.out[layout.OUT_INBOUND_TAIL]
        at = layout.IN_RING + number % CAPACITY * layout.RECORD_WORDS
        record = (kind | 2 << 32, 0, sequence, layout.pack_source(1, 0, 1), 0, 0, 0, number + 1)
        for word, value in enumerate(record):
            self.into[at + word] = value
        self.out[layout.OUT_INBOUND_TAIL] = number + 1

    def last_message(self) -> LastMessage | None:
        return self.reader.read(self.out, self.into).message


def words(count: int) -> Words:
    return array("Q", bytes(8 * count))


def test_last_message_is_the_last_one_taken() -> None:
    remains = Remains()
    assert remains.last_message() is None
    for sequence in range(1, 21):
        remains.take(Inbound.DELIVER, sequence)
        remains.take(Inbound.SEGMENTS_GONE, 7)
        message = remains.last_message()
        assert message
        assert (message.type_name, message.topic) == ("sensor_msgs/msg/LaserScan", "front")
        assert (message.sequence, message.sender) == (sequence, "laser")
    for _ in range(CAPACITY):
        remains.take(Inbound.SEGMENTS_GONE, 7)
    assert remains.last_message() is None


def test_overwritten_record_is_not_reported() -> None:
    remains = Remains()
    remains.take(Inbound.DELIVER, 5)
    remains.into[layout.IN_RING + 7] = 1 + CAPACITY
    assert remains.last_message() is None


def test_activity_and_counters_are_reported() -> None:
    remains = Remains()
    remains.out[layout.OUT_ACTIVITY] = Activity.TICK
    remains.out[layout.OUT_HANDLED] = 12
    write_text(remains.out, layout.OUT_STATUS, layout.LINE_WORDS, "all is well")
    found = remains.reader.read(remains.out, remains.into)
    assert (found.activity, found.status, found.counters["handled"]) == ("tick", "all is well", 12)
    assert found.activity_s > 0


@given(st.lists(WORD, min_size=40, max_size=40), st.lists(WORD, min_size=8, max_size=8), WORD)
def test_garbage_in_a_dead_modules_memory_causes_no_error(
    own: list[int], record: list[int], activity: int
) -> None:
    remains = Remains()
    for index, value in enumerate(own):
        remains.out[layout.HEADER_WORDS + index] = value
    remains.reader.read(remains.out, remains.into)
    remains.out[layout.OUT_INBOUND_TAIL] = 1
    remains.out[layout.OUT_ACTIVITY] = activity
    for index, value in enumerate([*record[:7], 1]):
        remains.into[layout.IN_RING + index] = value
    remains.reader.read(remains.out, remains.into)
