"""The data segments of one incarnation of a module, and the blocks in them that hold its messages."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from robbie_mp.errors import RobbieError
from robbie_mp.transport import layout
from robbie_mp.transport.allocator import BlockAllocator
from robbie_mp.transport.segment import Segment, SharedMemoryFull
from robbie_mp.transport.words import WORD_BYTES

# A message starts with 4 bytes of encapsulation; its body is to lie at a multiple of 8.
LEAD_BYTES = 4
_HEADER_BYTES = layout.HEADER_WORDS * WORD_BYTES


class MessageTooLarge(RobbieError, ValueError):
    """A message can never fit into its module's data segments; raise `memory.limit_bytes` in the profile.

    Example scenarios:
      - a 50 MB point cloud from a module limited to 16 MB
    """


class Block(NamedTuple):
    """A piece of a data segment, for one message."""

    number: int
    """Never used twice by an incarnation."""
    segment: int
    offset: int
    """Where the message starts in the segment, in bytes."""
    buffer: memoryview
    """The whole segment, writable."""


class BlockStore:
    """Allocates blocks, adding segments up to a limit.

    Args:
        create: makes the data segment with a given number and size in words.
        segment_bytes: size of the first one.
        limit_bytes: of all together.
    """

    def __init__(self, create: Callable[[int, int], Segment], segment_bytes: int, limit_bytes: int):
        self._create = create
        self._next_bytes = segment_bytes
        self._limit_bytes = limit_bytes
        self._segments: list[tuple[Segment, BlockAllocator]] = []
        self._taken: dict[int, tuple[BlockAllocator, int]] = {}
        self._numbers = 0
        self.total_bytes = 0

    @property
    def segment_count(self) -> int:
        """Data segments made so far."""
        return len(self._segments)

    @property
    def taken(self) -> int:
        """Blocks that are in use."""
        return len(self._taken)

    def allocate(self, size: int) -> Block | None:
        """Return a block for a message of `size` bytes, or None if all the memory is in use.

        Raises:
            MessageTooLarge: it would not fit if all the memory were free.
        """
        needed = size + LEAD_BYTES
        for index, (segment, allocator) in enumerate(self._segments):
            offset = allocator.allocate(needed)
            if offset is not None:
                return self._take(index, segment, allocator, offset)
        if not self._grow(needed):
            return None
        segment, allocator = self._segments[-1]
        offset = allocator.allocate(needed)
        assert offset is not None, "a new segment holds the block it was made for"
        return self._take(len(self._segments) - 1, segment, allocator, offset)

    def _take(self, index: int, segment: Segment, allocator: BlockAllocator, offset: int) -> Block:
        self._numbers += 1
        self._taken[self._numbers] = (allocator, offset)
        return Block(self._numbers, index, offset + LEAD_BYTES, segment.buffer)

    def _grow(self, needed: int) -> bool:
        whole = needed + _HEADER_BYTES + 2 * 64
        if whole > self._limit_bytes:
            raise MessageTooLarge(
                f"a message of {needed - LEAD_BYTES} bytes does not fit into this module's memory of "
                f"{self._limit_bytes} bytes; raise memory.limit_bytes in the profile"
            )
        size = min(max(self._next_bytes, whole), self._limit_bytes - self.total_bytes)
        if size < whole:
            return False
        words = -(-size // WORD_BYTES)
        try:
            segment = self._create(len(self._segments), words)
        except SharedMemoryFull:
            return False
        self._segments.append((segment, BlockAllocator(_HEADER_BYTES, segment.size - _HEADER_BYTES)))
        self.total_bytes += segment.size
        self._next_bytes = 2 * segment.size
        return True

    def free(self, numbers: Iterable[int]) -> None:
        """Take blocks back; a number that is not in use is passed over, since the core may say it twice."""
        for number in numbers:
            taken = self._taken.pop(number, None)
            if taken is not None:
                taken[0].free(taken[1])

    def close(self) -> None:
        """Unmap all segments; their names are the supervisor's to unlink."""
        for segment, _ in self._segments:
            segment.close()
        self._segments.clear()
