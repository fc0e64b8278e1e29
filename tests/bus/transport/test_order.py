"""Fences: a reader that finds the word written last also finds the words written before it.

Processors such as ARM may show the stores of one process to another in any order, unless both processes issue
a fence. These tests imitate that: the words before the last one only become visible when the reader issues
its fence, and a writer's fence looks at what has been stored by then.
"""

import os
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robbie_mp.base.linux.proc import ProcessIdentity
from robbie_mp.bus.transport import layout, segment, tables
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.records import MessageHandling, Outbound
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names
from robbie_mp.bus.transport.tables import ChannelName, CoreTables, DeclarationRow, TableSizes
from robbie_mp.bus.transport.words import Words

RUN = f"testordr{os.getpid()}"
NAME = f"robbie-{RUN}/board"
IMAGE = ChannelName("sensor_msgs/msg/Image", 1, "front")
SIZES = TableSizes(slots=2, channels=2, subscriptions=2, handles=2, references=2)


@pytest.fixture
def folder() -> Iterator[None]:
    make_folder(RUN)
    yield
    remove_names(RUN)


def zeros(count: int) -> "array[int]":
    return array("Q", bytes(8 * count))


def reveal_at_fence(
    monkeypatch: pytest.MonkeyPatch, module: object, words: Words, first: int, count: int
) -> None:
    """Hide some words until the code of a module issues a fence."""
    hidden = [words[at] for at in range(first, first + count)]
    for at in range(first, first + count):
        words[at] = 0

    def fence() -> None:
        for at, value in enumerate(hidden, first):
            words[at] = value

    monkeypatch.setattr(module, "new_fence", lambda: fence)


@pytest.mark.usefixtures("folder")
def test_header_is_complete_before_the_magic_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    stored: list[list[int]] = []

    def fence() -> None:
        stored.append(array("Q", Path(SHARED_MEMORY, NAME).read_bytes())[: layout.HEADER_WORDS].tolist())

    monkeypatch.setattr(segment, "new_fence", lambda: fence)
    Segment.create(NAME, 64, SegmentKind.BOARD).close()
    [header] = stored
    assert header[layout.HEADER_MAGIC] == 0
    assert header[layout.HEADER_KIND] == SegmentKind.BOARD
    assert header[layout.HEADER_CREATOR_PID] == os.getpid()
    assert header[layout.HEADER_CREATOR_START] == ProcessIdentity.own().start_ticks


@pytest.mark.usefixtures("folder")
def test_process_that_attaches_and_sees_the_magic_sees_the_header(monkeypatch: pytest.MonkeyPatch) -> None:
    board = Segment.create(NAME, 64, SegmentKind.BOARD)
    reveal_at_fence(monkeypatch, segment, board.words, layout.HEADER_VERSION, 3)
    Segment.attach(NAME, SegmentKind.BOARD).close()
    board.close()


def test_observer_that_sees_a_declaration_sees_its_whole_row(monkeypatch: pytest.MonkeyPatch) -> None:
    out = zeros(layout.OUT_RING)
    row = DeclarationRow(0, Outbound.SUBSCRIBE, IMAGE, MessageHandling.KEEP_ONLY_NEWEST, "on_image")
    row.write(out, lambda: None)
    first = layout.OUT_DECLARATIONS + layout.DECLARATION_VERSION
    reveal_at_fence(monkeypatch, tables, out, first, layout.DECLARATION_WORDS - 1)
    assert list(DeclarationRow.read_all(out)) == [row]


def test_declaration_is_complete_before_its_kind_says_so() -> None:
    out = zeros(layout.OUT_RING)
    row = DeclarationRow(3, Outbound.ADVERTISE, IMAGE, MessageHandling.ALWAYS_DELIVER, "")
    seen: list[DeclarationRow] = []
    row.write(out, lambda: seen.append(DeclarationRow.read(out, 3)))
    assert seen == [row._replace(kind=0)]


def test_observer_that_sees_an_open_row_sees_its_names(monkeypatch: pytest.MonkeyPatch) -> None:
    core = CoreTables.create(zeros(SIZES.words), SIZES)
    core.channel_row(0).write(IMAGE)
    core.subscription_row(0).write(1, IMAGE, MessageHandling.ALWAYS_DELIVER, is_reused=False)
    at = core.channel(0) + 1
    reveal_at_fence(monkeypatch, tables, core.words, at, layout.CHANNEL_WORDS - 1)
    assert [row.name for row in core.channels()] == [IMAGE]
    at = core.subscription(0) + 1
    reveal_at_fence(monkeypatch, tables, core.words, at, layout.SUBSCRIPTION_WORDS - 1)
    assert [(row.name, row.slot) for row in core.subscriptions()] == [(IMAGE, 1)]


@pytest.mark.parametrize("kind", ["channel", "subscription"])
def test_row_is_complete_before_its_state_says_so(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    core = CoreTables.create(zeros(SIZES.words), SIZES)
    seen: list[tuple[int, ChannelName]] = []
    row = core.channel_row(1) if kind == "channel" else core.subscription_row(1)

    def new_fence() -> Callable[[], None]:
        return lambda: seen.append((row.state, row.name))

    monkeypatch.setattr(tables, "new_fence", new_fence)
    if isinstance(row, tables.ChannelRow):
        row.write(IMAGE)
    else:
        row.write(1, IMAGE, MessageHandling.ALWAYS_DELIVER, is_reused=True)
    assert (seen, row.state) == ([(0, IMAGE)], tables.ROW_OPEN)
