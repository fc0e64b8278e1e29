import gc
import mmap
import os
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.ring import RingPlace
from robbie_mp.bus.transport.segment import Segment, SegmentMismatch, SegmentMissing, SharedMemoryFull
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names
from robbie_mp.bus.transport.words import read_text, write_text
from tests._support.growth import blocks_kept
from tests._support.implementations import NATIVE

RUN = f"testsegm{os.getpid()}"
NAME = f"robbie-{RUN}/one"


@pytest.fixture(autouse=True)
def folder() -> Iterator[None]:
    make_folder(RUN)
    yield
    remove_names(RUN)


@pytest.fixture
def segment() -> Iterator[Segment]:
    made = Segment.create(NAME, 1024, SegmentKind.DATA, slot=3, incarnation=2)
    yield made
    made.close()
    made.unlink()


def test_what_one_process_writes_the_other_reads(segment: Segment) -> None:
    other = Segment.attach(NAME, SegmentKind.DATA)
    segment.words[100] = 12345
    assert other.words[100] == 12345
    assert (other.words[layout.HEADER_SLOT], other.words[layout.HEADER_INCARNATION]) == (3, 2)
    other.close()


def test_reader_cannot_write(segment: Segment) -> None:
    other = Segment.attach(NAME, SegmentKind.DATA)
    with pytest.raises(TypeError):
        other.words[100] = 1
    with pytest.raises(TypeError):
        other.buffer[800] = 1
    other.close()


def test_segment_is_private_to_its_user(segment: Segment) -> None:
    assert (SHARED_MEMORY / NAME).stat().st_mode & 0o777 == 0o600


def test_pages_are_allocated_when_the_segment_is_made(segment: Segment) -> None:
    assert (SHARED_MEMORY / NAME).stat().st_blocks * 512 >= 1024 * 8


class AdviceIgnored(mmap.mmap):
    """A mapping as in qemu's user emulation, which accepts advice and does nothing."""

    def madvise(self, option: int, start: int = 0, length: int | None = None) -> None:
        """Do nothing."""


def test_pages_are_allocated_at_once_where_advice_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mmap, "mmap", AdviceIgnored)
    made = Segment.create(NAME, 1024, SegmentKind.HISTORY, at_first_bytes=4096)
    assert made.populated_bytes == made.size
    assert (SHARED_MEMORY / NAME).stat().st_blocks * 512 >= made.size
    made.close()


def test_no_room_is_an_error_that_says_what_to_do_and_leaves_no_name() -> None:
    too_much = os.statvfs(SHARED_MEMORY).f_blocks * os.statvfs(SHARED_MEMORY).f_frsize * 2
    with pytest.raises(SharedMemoryFull, match="enlarge /dev/shm"):
        Segment.create(NAME, too_much // 8, SegmentKind.DATA)
    assert not (SHARED_MEMORY / NAME).exists()


def test_segment_that_is_just_being_made_counts_as_missing(segment: Segment) -> None:
    segment.words[layout.HEADER_MAGIC] = 0
    with pytest.raises(SegmentMissing, match="just being made"):
        Segment.attach(NAME, SegmentKind.DATA)


def test_missing_segment_is_named() -> None:
    with pytest.raises(SegmentMissing, match=NAME):
        Segment.attach(NAME, SegmentKind.DATA)


@pytest.mark.parametrize(
    ("word", "value"),
    [
        (layout.HEADER_MAGIC, 1),
        (layout.HEADER_VERSION, 99),
        (layout.HEADER_KIND, 1),
        (layout.HEADER_BYTES, 8),
    ],
)
def test_segment_of_another_kind_or_layout_is_refused(segment: Segment, word: int, value: int) -> None:
    segment.words[word] = value
    with pytest.raises(SegmentMismatch, match="same version"):
        Segment.attach(NAME, SegmentKind.DATA)


@pytest.mark.skipif(NATIVE is None, reason="C is not used here")
def test_memory_that_c_uses_stays_mapped_until_c_lets_it_go(segment: Segment) -> None:
    assert NATIVE is not None
    words = Segment.attach(NAME, SegmentKind.DATA, write=True)
    writer = NATIVE.RingWriter(RingPlace(words.words, 20, 32, 4, words.words, 21))
    words.close()
    assert times_mapped(segment) == 2
    writer.push(7, 0, 0, 0, 0, 0, 0)
    assert segment.words[32] == 7
    with pytest.raises(ValueError, match="released"):
        words.words[100] = 1
    writer.close()
    del words
    assert times_mapped(segment) == 1


@pytest.mark.skipif(NATIVE is None, reason="C is not used here")
def test_words_are_taken_from_a_forked_process_though_c_uses_them(segment: Segment) -> None:
    assert NATIVE is not None
    writer = NATIVE.RingWriter(RingPlace(segment.words, 20, 32, 4, segment.words, 21))
    words = segment.words
    segment.disown()
    with pytest.raises(ValueError, match="released"):
        words[100] = 1
    writer.close()


def times_mapped(segment: Segment) -> int:
    gc.collect()
    return Path("/proc/self/maps").read_text().count(segment.name)


def test_attaching_keeps_no_descriptor(segment: Segment) -> None:
    before = len(os.listdir("/proc/self/fd"))
    others = [Segment.attach(NAME, SegmentKind.DATA) for _ in range(5)]
    # an mmap of Python keeps a duplicate of the descriptor; it goes with the mapping
    assert len(os.listdir("/proc/self/fd")) <= before + len(others)
    for other in others:
        other.close()
    assert len(os.listdir("/proc/self/fd")) == before
    assert resource.getrlimit(resource.RLIMIT_NOFILE)[0] > 0


@pytest.mark.parametrize("text", ["", "laser", "äöü" * 10, "x" * 500])
def test_texts_survive_or_are_cut_at_a_character(text: str) -> None:
    words = [0] * 40
    capacity = 1 + 64 // 8  # words: the length, and 64 bytes
    write_text(words, 3, capacity, text)
    found = read_text(words, 3, capacity)
    assert text.startswith(found)
    assert len(found.encode()) >= min(len(text.encode()), 64) - 3


def test_garbage_reads_as_some_bounded_text() -> None:
    assert len(read_text([(1 << 64) - 1] * 40, 3, 9)) <= 64


def test_segment_that_was_attached_and_closed_leaves_nothing_behind(segment: Segment) -> None:
    assert blocks_kept(lambda: Segment.attach(NAME, SegmentKind.DATA).close(), 300) < 0.1
