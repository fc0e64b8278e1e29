"""The data segments of one incarnation of a module, and the blocks in them that hold its messages."""

from collections.abc import Callable, Iterable, Sized
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.allocator import BLOCK_ALIGNMENT, BlockAllocator
from robbie_mp.bus.transport.segment import Segment, SharedMemoryFull
from robbie_mp.bus.transport.words import WORD_BYTES, Words

# A message starts with 4 bytes of encapsulation; its body is aligned to 8 bytes.
LEAD_BYTES = 4
_HEADER_BYTES = layout.DATA_BLOCKS * WORD_BYTES
_FREE_BYTES = layout.DATA_FREE_BYTES
_OVERHEAD = LEAD_BYTES + BLOCK_ALIGNMENT - 1
_ALIGNED = -BLOCK_ALIGNMENT
"""`size + _OVERHEAD & _ALIGNED` is the capacity of the block for a message of `size` bytes."""


def block_bytes(size: int) -> int:
    """Return the capacity of the block for a message of `size` bytes."""
    return (size + _OVERHEAD) & _ALIGNED


class MessageTooLarge(RobbieError, ValueError):
    """A message cannot fit into its module's data segments; raise `memory.limit_bytes` in the profile.

    Example scenarios:
      - a 50 MB point cloud from a module limited to 16 MB
    """


class Block:
    """A part of a data segment that holds one message.

    Attributes:
        number: unique within the incarnation; a block that is used again gets a new number.
        segment: number of the data segment.
        offset: where the message starts in it, in bytes.
        buffer: the whole segment, writable.
        capacity: bytes that it was allocated with.
        words: the segment as words.
    """

    __slots__ = ("buffer", "capacity", "number", "offset", "segment", "words")

    def __init__(
        self,
        number: int,
        segment: int,
        offset: int,
        buffer: memoryview,
        capacity: int = 0,
        words: Words | None = None,
    ):
        self.number = number
        self.segment = segment
        self.offset = offset
        self.buffer = buffer
        self.capacity = capacity
        self.words: Words = buffer.cast("Q") if words is None else words


class KeptBlocks:
    """The blocks in use and the free ones; the type of the same name in C does the same.

    Attributes:
        taken: blocks in use, by their numbers.
        taken_bytes: total size of these.
        kept: free blocks by their capacity.
        room_bytes: bytes that can be used.
    """

    def __init__(self) -> None:
        self.taken: dict[int, Block] = {}
        self.taken_bytes = 0
        self.kept: dict[int, list[Block]] = {}
        self.room_bytes = 0
        self._numbers = 0

    def reuse(self, size: int) -> Block | None:
        """Return a kept block for a message of this size, or None if there is none."""
        kept = self.kept.get((size + _OVERHEAD) & _ALIGNED)
        if not kept:
            return None
        block = kept.pop()
        self._numbers = block.number = number = self._numbers + 1
        self.taken[number] = block
        self.taken_bytes += block.capacity
        block.words[_FREE_BYTES] = self.room_bytes - self.taken_bytes  # for subscribers
        return block

    def has_kept(self, size: int) -> bool:
        """Whether `reuse` would find a block."""
        return bool(self.kept.get((size + _OVERHEAD) & _ALIGNED))

    def keep(self, block: Block) -> None:
        """Keep a new block for the next message of its size."""
        self.kept.setdefault(block.capacity, []).append(block)

    def free(self, numbers: Iterable[int]) -> None:
        """Free blocks; numbers that are not in use are ignored, as the core may repeat them."""
        for number in numbers:
            block = self.taken.pop(number, None)
            if block is not None:
                self.taken_bytes -= block.capacity
                self.keep(block)

    def clear(self) -> None:
        """Let all blocks go."""
        self.taken.clear()
        self.kept.clear()
        self.taken_bytes = 0


class BlockStore:
    """Allocates blocks, and adds segments up to a limit.

    A robot's messages come in few sizes, so a freed block is kept for the next message of its size. Kept
    blocks are only returned to the allocators, which can join them, when no other memory is left.

    Args:
        create: makes the data segment with a given number and size in words.
        segment_bytes: size of the first segment.
        limit_bytes: maximum size of all segments together.
        native: what is written in C; None: Python does it.

    Attributes:
        ample_bytes: if more bytes than this are in use, memory is getting short.
        enough_bytes: if at most this many bytes are in use, memory is no longer short.
        total_bytes: total size of the segments.
        blocks: the blocks in use and the free ones.
    """

    def __init__(
        self,
        create: Callable[[int, int], Segment],
        segment_bytes: int,
        limit_bytes: int,
        native: Native | None = None,
    ):
        self._create = create
        self._next_bytes = segment_bytes
        self._limit_bytes = limit_bytes
        self._segments: list[tuple[Segment, BlockAllocator]] = []
        self._block: Any = Block if native is None else native.Block
        self.blocks: Any = KeptBlocks() if native is None else native.KeptBlocks()
        reuse: Any = self.blocks.reuse
        self.reuse: Callable[[int], Block | None] = reuse
        """Return a kept block for a message of this size, or None if there is none."""
        self.has_kept: Callable[[int], bool] = self.blocks.has_kept
        """Whether `reuse` would find a block."""
        self.free: Callable[[Iterable[int]], None] = self.blocks.free
        """Free blocks; numbers that are not in use are ignored, as the core may repeat them."""
        self.taken: Sized = self.blocks.taken
        """The blocks in use."""
        self._set_room(limit_bytes)
        self.total_bytes = 0

    @property
    def taken_bytes(self) -> int:
        """Total size of the blocks in use."""
        size: int = self.blocks.taken_bytes
        return size

    @property
    def room_bytes(self) -> int:
        """Bytes that can be used: less than the limit while /dev/shm is full."""
        size: int = self.blocks.room_bytes
        return size

    def _set_room(self, room_bytes: int) -> None:
        self.blocks.room_bytes = room_bytes
        self.ample_bytes = room_bytes * 7 // 8
        self.enough_bytes = room_bytes * 3 // 4

    @property
    def segment_count(self) -> int:
        """Data segments made so far."""
        return len(self._segments)

    def allocate(self, size: int) -> Block | None:
        """Return a block for a message of `size` bytes, or None if all the memory is in use.

        Raises:
            MessageTooLarge: it would not fit if all the memory were free.
        """
        block = self.reuse(size)
        if block is None and self._keep_another((size + _OVERHEAD) & _ALIGNED):
            block = self.reuse(size)
        return block

    def keep_one(self, size: int) -> None:
        """Keep a block for the next message of this size, if there is memory."""
        if not self.has_kept(size):
            self._fit((size + _OVERHEAD) & _ALIGNED)

    def _keep_another(self, capacity: int) -> bool:
        if self._fit(capacity):
            return True
        kept: dict[int, list[Block]] = self.blocks.kept
        if any(kept.values()):
            for blocks in kept.values():
                while blocks:
                    block = blocks.pop()
                    self._segments[block.segment][1].free(block.offset - LEAD_BYTES)
            if self._fit(capacity):
                return True
        return self._grow(capacity) and self._fit(capacity)

    def _fit(self, capacity: int) -> bool:
        """Allocate a block and keep it; return whether a segment had room."""
        for index, (segment, allocator) in enumerate(self._segments):
            offset = allocator.allocate(capacity)
            if offset is not None:
                start = offset + LEAD_BYTES
                self.blocks.keep(self._block(0, index, start, segment.buffer, capacity, segment.words))
                return True
        return False

    def _grow(self, needed: int) -> bool:
        whole = needed + _HEADER_BYTES + BLOCK_ALIGNMENT
        if whole > self._limit_bytes:
            raise MessageTooLarge(
                f"a message of about {needed} bytes does not fit into this module's memory of "
                f"{self._limit_bytes} bytes; raise memory.limit_bytes in the profile"
            )
        size = min(max(self._next_bytes, whole), self._limit_bytes - self.total_bytes)
        if size < whole:
            return False
        words = -(-size // WORD_BYTES)
        try:
            segment = self._create(len(self._segments), words)
        except SharedMemoryFull:
            self._set_room(self.total_bytes)
            return False
        self._set_room(self._limit_bytes)
        self._segments.append((segment, BlockAllocator(_HEADER_BYTES, segment.size - _HEADER_BYTES)))
        self.total_bytes += segment.size
        self._next_bytes = 2 * segment.size
        return True

    def close(self) -> None:
        """Unmap all segments; the supervisor unlinks their names."""
        self.blocks.clear()
        for segment, _ in self._segments:
            segment.close()
        self._segments.clear()
