"""Allocates the blocks of a data segment. Its state is private memory of the module."""

from bisect import bisect

BLOCK_ALIGNMENT = 64  # a cache line, so that two messages never share one


class BlockAllocator:
    """First-fit allocator over one segment; a freed block is joined with its free neighbours.

    Args:
        start: offset of the first usable byte.
        size: bytes from there on.
    """

    def __init__(self, start: int, size: int):
        start_aligned = -(-start // BLOCK_ALIGNMENT) * BLOCK_ALIGNMENT
        end = (start + size) // BLOCK_ALIGNMENT * BLOCK_ALIGNMENT
        self._extents: list[tuple[int, int]] = [(start_aligned, end - start_aligned)]
        """Offset and size of the free extents, in order; no two of them are adjacent."""
        self._sizes: dict[int, int] = {}

    def allocate(self, size: int) -> int | None:
        """Return the offset of a block of at least `size` bytes, or None if there is none."""
        size = -(-size // BLOCK_ALIGNMENT) * BLOCK_ALIGNMENT
        for index, (offset, free) in enumerate(self._extents):
            if free >= size:
                self._extents[index : index + 1] = [(offset + size, free - size)] if free > size else []
                self._sizes[offset] = size
                return offset
        return None

    def free(self, offset: int) -> None:
        """Free a block.

        Raises:
            KeyError: no such block is in use.
        """
        end = offset + self._sizes.pop(offset)
        extents = self._extents
        index = bisect(extents, (offset,))
        if index < len(extents) and extents[index][0] == end:
            end += extents.pop(index)[1]
        if index and sum(extents[index - 1]) == offset:
            index -= 1
            offset = extents.pop(index)[0]
        extents.insert(index, (offset, end - offset))
