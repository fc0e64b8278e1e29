"""Watching a run whose modules have written over their own memory."""

import os
from array import array
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.board import Board, SlotState, Totals
from robbie_mp.bus.transport.layout import LINE_WORDS, SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, SegmentMissing, make_folder, remove_names
from robbie_mp.bus.transport.tables import CoreTables, TableSizes
from robbie_mp.bus.transport.words import WORD_MAX, write_text

RUN = f"testobsv{os.getpid()}"


@pytest.fixture
def camera() -> Iterator[Segment]:
    """The out segment of the one module of a run that seems to be going on."""
    sizes = TableSizes(slots=2, channels=2, subscriptions=2, handles=2, references=2)
    make_folder(RUN)
    segments = [
        Segment.create(names.board(RUN), layout.board_words(3), SegmentKind.BOARD),
        Segment.create(names.core(RUN), sizes.words, SegmentKind.CORE),
        Segment.create(names.outbound(RUN, 1, 1), layout.out_words(16), SegmentKind.OUT),
    ]
    board = Board(segments[0].words)
    board.create(["supervisor", "camera", "core"])
    board.write(1, SlotState("camera", 2, 1, 1, 0, 0, "ready", Totals()))
    CoreTables.create(segments[1].words, sizes)
    yield segments[2]
    for segment in segments:
        segment.close()
    remove_names(RUN)


class Stores(array):  # type: ignore[type-arg] # not subscriptable when it runs
    """Words that note each store, in order."""

    made: list[int]

    def __setitem__(self, at: int, value: int) -> None:  # type: ignore[override]
        self.made = [*getattr(self, "made", []), at]
        super().__setitem__(at, value)


def test_observer_that_comes_while_the_tables_are_made_does_not_take_them_for_empty() -> None:
    """All channels read 0 for ever, to a tool that came between two stores of the supervisor."""
    sizes = TableSizes(slots=2, channels=2, subscriptions=2, handles=2, references=2)
    full = Stores("Q", bytes(8 * sizes.words))
    CoreTables.create(full, sizes)
    for stored in range(len(full.made) + 1):
        words = array("Q", bytes(8 * sizes.words))
        for at in full.made[:stored]:
            words[at] = full[at]
        if stored == len(full.made):
            assert CoreTables.attach(words).sizes == sizes
            return
        with pytest.raises(SegmentMissing, match="just being made"):
            CoreTables.attach(words)


def test_observer_of_a_run_that_is_just_being_made_says_so() -> None:
    make_folder(RUN)
    sizes = TableSizes(slots=2, channels=2, subscriptions=2, handles=2, references=2)
    try:
        with (
            closing(Segment.create(names.board(RUN), layout.board_words(3), SegmentKind.BOARD)),
            closing(Segment.create(names.core(RUN), sizes.words, SegmentKind.CORE)) as core,
        ):
            with pytest.raises(SegmentMissing, match="just being made"):
                RunObserver(RUN)
            CoreTables.create(core.words, sizes)
            RunObserver(RUN).close()
    finally:
        remove_names(RUN)


def test_garbage_in_a_modules_own_words_is_shown_as_it_is(camera: Segment) -> None:
    for at in range(layout.HEADER_WORDS, layout.OUT_DECLARATIONS):
        camera.words[at] = WORD_MAX
    observer = RunObserver(RUN)
    figures = observer.modules()[1]
    observer.close()
    assert figures.activity == "unknown"
    assert figures.published == WORD_MAX


def test_module_that_has_ended_keeps_its_status_and_counts_once(camera: Segment) -> None:
    write_text(camera.words, layout.OUT_STATUS, LINE_WORDS, "42 images")
    camera.words[layout.OUT_PUBLISHED] = 42
    board = Segment.attach(names.board(RUN), SegmentKind.BOARD, write=True)
    ended = SlotState("camera", 2, 0, 1, 0, 0, "SIGTERM", Totals(published=42))
    Board(board.words).write(1, ended)
    board.close()
    observer = RunObserver(RUN)
    figures = observer.modules()[1]
    observer.close()
    assert (figures.status, figures.published, figures.activity) == ("42 images", 42, "idle")


def test_counts_alone_are_those_of_all_figures(camera: Segment) -> None:
    camera.words[layout.OUT_PUBLISHED] = 42
    with closing(RunObserver(RUN)) as observer:
        figures, counts = observer.modules()[1], observer.modules(only_counts=True)[1]
    assert figures.rss_bytes > 0 and figures.work is not None
    unread: dict[str, Any] = {
        "cpu_s": 0.0,
        "rss_bytes": 0,
        "shared_bytes": 0,
        "threads": 0,
        "wakeups": 0,
        "work": None,
    }
    assert counts == replace(figures, **unread)


def test_module_whose_segment_is_none_any_more_is_still_listed(camera: Segment) -> None:
    camera.words[layout.HEADER_MAGIC] = 0
    observer = RunObserver(RUN)
    figures = observer.modules()[1]
    observer.close()
    assert figures.name == "camera"
    assert figures.published == 0


@pytest.mark.usefixtures("camera")
def test_observer_keeps_no_memory_of_a_tool_that_has_left() -> None:
    with closing(Segment.attach(names.board(RUN), SegmentKind.BOARD, write=True)) as segment:
        board = Board(segment.words)
        board.create(["supervisor", "~tool1", "core"])
        board.go()
        of_others = times_mapped(names.outbound(RUN, 1, 1))
        with closing(RunObserver(RUN)) as observer:
            for pid, mappings in ((os.getpid(), 1), (0, 0)):
                board.write(1, SlotState("~tool1", 2, pid, 1, 0, 0, "attached", Totals()))
                observer.unconnected()
                assert times_mapped(names.outbound(RUN, 1, 1)) == of_others + mappings


def times_mapped(name: str) -> int:
    return Path("/proc/self/maps").read_text().count(name)


@pytest.mark.parametrize("name", ["data-x-1", "out-999-1", "data", "checkpoint-1e3", "in--"])
@pytest.mark.usefixtures("camera")
def test_file_with_another_name_among_the_segments_belongs_to_nobody(name: str) -> None:
    """`robbie top` ended by an error."""
    path = SHARED_MEMORY / names.folder(RUN) / name
    path.touch()
    with closing(RunObserver(RUN)) as observer:
        owners = {segment.name: segment.module for segment in observer.segments()}
    assert owners[f"{names.folder(RUN)}/{name}"] == ""
    assert owners[names.outbound(RUN, 1, 1)] == "camera"
