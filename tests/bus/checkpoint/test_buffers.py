"""The two segments that checkpoints alternate between."""

import os

import numpy as np
import pytest

from robbie_mp.bus.checkpoint.buffers import IMAGE_BEGIN, CheckpointBuffers
from robbie_mp.bus.checkpoint.errors import CheckpointDamaged, CheckpointTooLarge
from robbie_mp.bus.checkpoint.image import decode, encode, lay_out
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment, SharedMemoryFull
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from tests.bus.checkpoint.conftest import RUN, SLOT, SlotOfARun


def write(buffers: CheckpointBuffers, *numbers: int, size: int = 10) -> None:
    for number in numbers:
        buffers.write(lay_out({"number": number, "array": np.full(size, number)}), taken_ns=number)


def number_in(buffers: CheckpointBuffers) -> int | None:
    return None if buffers.found is None else buffers.found.state["number"]


def segments(slot: SlotOfARun) -> dict[str, int]:
    found = SHARED_MEMORY.glob(slot.name(0)[:-1] + "*")
    return {f"{path.parent.name}/{path.name}": path.stat().st_size for path in found}


def test_first_incarnation_finds_no_checkpoint_and_creates_no_segment(slot: SlotOfARun) -> None:
    assert slot.start().found is None
    assert segments(slot) == {}


def test_next_incarnation_restores_the_newest_checkpoint(slot: SlotOfARun) -> None:
    for number in range(1, 6):
        buffers = slot.start()
        assert number_in(buffers) == (number - 1 or None)
        assert buffers.damaged == []
        write(buffers, number)
    found = slot.start().found
    assert found is not None
    assert found.sequence == 5


def test_checkpoints_of_equal_size_need_only_two_segments(slot: SlotOfARun) -> None:
    buffers = slot.start()
    write(buffers, 1, 2)
    inodes = {name: os.stat(f"{SHARED_MEMORY}/{name}").st_ino for name in segments(slot)}
    write(buffers, *range(3, 20))
    assert {name: os.stat(f"{SHARED_MEMORY}/{name}").st_ino for name in segments(slot)} == inodes
    assert len(inodes) == 2


def test_state_may_grow_and_shrink(slot: SlotOfARun) -> None:
    buffers = slot.start()
    for number, size in enumerate([10, 3000, 4000, 10, 50_000, 20_000], 1):
        write(buffers, number, size=size)
        reader = CheckpointBuffers(RUN, SLOT, 9, 1 << 20)
        assert number_in(reader) == number
        reader.close()
    assert len(segments(slot)) == 2


def test_slowly_growing_state_rarely_needs_a_new_segment(slot: SlotOfARun) -> None:
    buffers = slot.start()
    inodes = set()
    for size in range(1000, 2000, 10):
        write(buffers, 1, size=size)
        inodes |= {os.stat(f"{SHARED_MEMORY}/{name}").st_ino for name in segments(slot)}
    assert len(inodes) <= 10


def test_state_at_the_size_limit_is_kept_and_a_larger_one_is_refused(slot: SlotOfARun) -> None:
    size = lay_out({"number": 1, "array": np.zeros(10)}).size
    exact = slot.start(limit_bytes=size)
    write(exact, 1)
    assert number_in(slot.start(limit_bytes=size)) == 1
    small = slot.start(limit_bytes=size - 1)
    with pytest.raises(CheckpointTooLarge, match=r"memory\.checkpoint_bytes"):
        write(small, 2)
    assert number_in(slot.start()) == 1


def test_full_memory_keeps_the_last_checkpoint(slot: SlotOfARun, request: pytest.FixtureRequest) -> None:
    buffers = slot.start()
    write(buffers, 1, 2)
    request.getfixturevalue("full_memory")
    with pytest.raises(SharedMemoryFull):
        write(buffers, 3, size=10_000)
    with pytest.raises(SharedMemoryFull):  # and again: the segment it would go to is gone
        write(buffers, 3, size=10_000)
    request.getfixturevalue("monkeypatch").undo()
    assert number_in(slot.start()) == 2
    write(slot.start(), 3, size=10_000)
    assert number_in(slot.start()) == 3


@pytest.mark.parametrize("offset", [0, 12, 16, 40, 64, 200])
def test_damaged_checkpoint_is_reported_and_the_previous_one_is_restored(
    slot: SlotOfARun, offset: int
) -> None:
    write(slot.start(), 1, 2)
    slot.damage(0, IMAGE_BEGIN + offset, 3)  # the first goes to segment 1
    buffers = slot.start()
    assert number_in(buffers) == 1
    assert len(buffers.damaged) == 1
    write(buffers, 3)
    again = slot.start()
    assert (number_in(again), again.damaged) == (3, [])


def test_two_damaged_checkpoints_are_reported_and_replaced(slot: SlotOfARun) -> None:
    write(slot.start(), 1, 2)
    for number in (0, 1):
        slot.damage(number, IMAGE_BEGIN + 70)
    buffers = slot.start()
    assert buffers.found is None
    assert len(buffers.damaged) == 2
    write(buffers, 3, 4)
    again = slot.start()
    assert (number_in(again), again.damaged) == (4, [])


@pytest.mark.parametrize("sequence", [1, 2**64 - 1])
def test_wrong_sequence_number_counts_as_damage(slot: SlotOfARun, sequence: int) -> None:
    write(slot.start(), 1, 2)
    slot.scribble(0, layout.CHECKPOINT_SEQUENCE * 8, sequence.to_bytes(8, "little"))
    buffers = slot.start()
    assert number_in(buffers) == 1
    assert len(buffers.damaged) == 1
    write(buffers, 3, 4)
    assert number_in(slot.start()) == 4


@pytest.mark.parametrize("loss", ["removed", "zeroed", "another kind"])
def test_loss_of_the_newest_checkpoint_is_reported_until_there_is_a_newer_one(
    slot: SlotOfARun, loss: str
) -> None:
    write(slot.start(), 1, 2)
    path = SHARED_MEMORY / slot.name(0)
    if loss == "removed":
        path.unlink()
    else:
        offset = layout.CHECKPOINT_SEQUENCE if loss == "zeroed" else layout.HEADER_KIND
        slot.scribble(0, offset * 8, bytes(8))
    for _ in range(2):  # its process may be killed before it has saved anything
        buffers = slot.start()
        assert number_in(buffers) == 1
        assert len(buffers.damaged) == 1
    write(buffers, 3)
    again = slot.start()
    assert (number_in(again), again.damaged) == (3, [])


def test_damage_of_the_checkpoint_before_the_newest_one_is_no_loss(slot: SlotOfARun) -> None:
    write(slot.start(), 1, 2)
    slot.damage(1, IMAGE_BEGIN + 70)
    buffers = slot.start()
    assert (number_in(buffers), buffers.damaged) == (2, [])


def test_checkpoint_that_a_killed_process_had_not_completed_is_no_loss(slot: SlotOfARun) -> None:
    buffers = slot.start()
    write(buffers, 1, 2)

    class Killed(Exception):
        pass

    class Interrupted:
        size = 8

        def write(self, _room: memoryview, _sequence: int, _taken_ns: int) -> None:
            raise Killed

    with pytest.raises(Killed):
        buffers.write(Interrupted(), taken_ns=3)  # type: ignore[arg-type]
    again = slot.start()
    assert (number_in(again), again.damaged) == (2, [])


@pytest.mark.parametrize("content", [b"", b"x", bytes(4096), b"\xff" * 4096])
def test_file_that_is_not_a_segment_is_replaced(slot: SlotOfARun, content: bytes) -> None:
    for number in (0, 1):
        (SHARED_MEMORY / slot.name(number)).write_bytes(content)
    buffers = slot.start()
    assert buffers.found is None
    write(buffers, 1, 2)
    assert number_in(slot.start()) == 2


def test_segment_is_allocated_completely_and_names_its_owner(slot: SlotOfARun) -> None:
    write(slot.start(), 1, size=100_000)
    (name,) = segments(slot)
    assert os.stat(f"{SHARED_MEMORY}/{name}").st_blocks * 512 >= 800_000
    segment = Segment.attach(name, SegmentKind.CHECKPOINT)
    assert (segment.words[layout.HEADER_SLOT], segment.words[layout.HEADER_INCARNATION]) == (1, 1)
    segment.close()


def test_held_checkpoint_remains_while_new_ones_are_written(slot: SlotOfARun) -> None:
    buffers = slot.start()
    write(buffers, 1, 2)
    with buffers.newest() as image:
        write(buffers, 3, 4, 5)
        assert decode(image).state["number"] == 2
        assert bytes(image) == encode({"number": 2, "array": np.full(10, 2)}, 2, 2)
    assert len(segments(slot)) == 2
    with buffers.newest() as image:
        assert decode(image).state["number"] == 5
    write(buffers, 6, 7)
    assert number_in(slot.start()) == 7


def test_hold_returns_nothing_without_a_checkpoint(slot: SlotOfARun) -> None:
    with pytest.raises(LookupError), slot.start().newest():
        pass
    write(slot.start(), 1)
    slot.damage(1, IMAGE_BEGIN)
    buffers = slot.start()
    with pytest.raises((LookupError, CheckpointDamaged)), buffers.newest():
        pass
