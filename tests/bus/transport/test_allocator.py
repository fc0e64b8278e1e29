import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.bus.transport.allocator import BLOCK_ALIGNMENT, BlockAllocator

SIZE = 64 << 10


def test_freed_memory_of_small_blocks_serves_a_large_one() -> None:
    allocator = BlockAllocator(0, SIZE)
    blocks = []
    while (offset := allocator.allocate(1000)) is not None:
        blocks.append(offset)
    for offset in blocks:
        allocator.free(offset)
    assert allocator.allocate(SIZE) == 0


def test_full_allocator_says_so_and_recovers() -> None:
    allocator = BlockAllocator(0, SIZE)
    first = allocator.allocate(SIZE)
    assert first is not None
    assert allocator.allocate(1) is None
    allocator.free(first)
    assert allocator.allocate(1) is not None


def test_freeing_twice_is_an_error() -> None:
    allocator = BlockAllocator(0, SIZE)
    offset = allocator.allocate(10)
    assert offset is not None
    allocator.free(offset)
    with pytest.raises(KeyError):
        allocator.free(offset)


@given(st.lists(st.one_of(st.integers(1, 9000), st.integers(-50, -1)), max_size=200), st.integers(0, 500))
def test_blocks_never_overlap_and_nothing_is_lost(steps: list[int], start: int) -> None:
    """A positive step allocates a block of that size in bytes, a negative one frees a block."""
    allocator = BlockAllocator(start, SIZE)
    taken: dict[int, int] = {}
    for step in steps:
        if step < 0:
            if taken:
                victim = list(taken)[step % len(taken)]
                del taken[victim]
                allocator.free(victim)
            continue
        offset = allocator.allocate(step)
        if offset is None:
            continue
        assert offset % BLOCK_ALIGNMENT == 0
        assert start <= offset <= start + SIZE - step
        assert all(offset + step <= other or other + size <= offset for other, size in taken.items())
        taken[offset] = step
    for offset in taken:
        allocator.free(offset)
    assert allocator.allocate(SIZE - 2 * BLOCK_ALIGNMENT) is not None
