import os
from collections.abc import Iterator

import pytest

from robbie_mp.bus.transport.blocks import BlockStore, MessageTooLarge
from robbie_mp.bus.transport.run_memory import make_block_store
from robbie_mp.bus.transport.segment import Segment, SharedMemoryFull
from robbie_mp.bus.transport.shared_folder import make_folder, remove_names
from tests._support.implementations import Native

RUN = f"testblck{os.getpid()}"


@pytest.fixture
def store(native: Native | None) -> Iterator[BlockStore]:
    make_folder(RUN)
    made = make_block_store(RUN, 1, 1, segment_bytes=4096, limit_bytes=64 << 10, native=native)
    yield made
    made.close()
    remove_names(RUN)


def test_no_segment_before_the_first_message(store: BlockStore) -> None:
    assert store.segment_count == 0
    assert store.allocate(100) is not None
    assert store.segment_count == 1


def test_message_body_lies_at_a_multiple_of_eight(store: BlockStore) -> None:
    for size in (1, 63, 64, 65, 1000):
        block = store.allocate(size)
        assert block is not None
        assert (block.offset + 4) % 8 == 0


def test_store_grows_up_to_its_limit_and_then_refuses(store: BlockStore) -> None:
    while store.allocate(1000) is not None:
        pass
    assert store.segment_count > 1
    assert store.total_bytes <= 64 << 10
    assert len(store.taken) >= 50


def test_freed_block_is_used_again(store: BlockStore) -> None:
    for _ in range(1000):
        block = store.allocate(3000)
        assert block is not None
        store.free([block.number])
    assert store.segment_count == 1


def test_block_freed_twice_is_passed_over(store: BlockStore) -> None:
    first = store.allocate(3000)
    assert first is not None
    store.free([first.number, first.number])
    assert len(store.taken) == 0


def test_message_larger_than_all_the_memory_is_an_error_that_says_what_to_do(store: BlockStore) -> None:
    with pytest.raises(MessageTooLarge, match=r"memory\.limit_bytes"):
        store.allocate(100 << 10)


def test_full_shared_memory_refuses() -> None:
    def no_room(_number: int, _words: int) -> Segment:
        raise SharedMemoryFull("full")

    assert BlockStore(no_room, 4096, 1 << 20).allocate(10) is None
