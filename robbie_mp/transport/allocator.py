"""Blocks of a data segment, kept in the module's own memory: nobody else needs to know."""

from bisect import bisect

BLOCK_ALIGNMENT = 64  # a cache line, so that two messages never share one


class BlockAllocator:
    """First fit over one segment; what is freed is joined with its free neighbours.

    Args:
        start: offset of the first usable byte.
        size: bytes from there on.
    """

    def __init__(self, start: int, size: int):
        start_aligned = -(-start // BLOCK_ALIGNMENT) * BLOCK_ALIGNMENT
        end = (start + size) // BLOCK_ALIGNMENT * BLOCK_ALIGNMENT
        self._extents: list[tuple[int, int]] = [(start_aligned, end - start_aligned)]
        """Offset and size of what is free, in order; no two of them touch."""
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
        """Take a block back.

        Raises:
            KeyError: no such block is handed out.
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
