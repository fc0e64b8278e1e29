"""Blocks of a module's data segments, kept in the module's own memory: nobody else needs to know."""

from bisect import insort

BLOCK_ALIGNMENT = 64  # a cache line, so that two messages never share one


class BlockAllocator:
    """First fit over one segment, with exact-size reuse in front.

    A robot's messages come in few sizes, so a freed block is mostly taken again by the next message of that
    size. Only when that fails are the blocks kept for reuse merged with their free neighbours.

    Args:
        start: offset of the first usable byte.
        size: bytes from there on.
    """

    def __init__(self, start: int, size: int):
        start_aligned = -(-start // BLOCK_ALIGNMENT) * BLOCK_ALIGNMENT
        end = (start + size) // BLOCK_ALIGNMENT * BLOCK_ALIGNMENT
        self._extents: list[tuple[int, int]] = [(start_aligned, end - start_aligned)]
        self._kept: dict[int, list[int]] = {}
        self._sizes: dict[int, int] = {}

    @property
    def used_blocks(self) -> int:
        """Blocks handed out."""
        return len(self._sizes)

    def allocate(self, size: int) -> int | None:
        """Return the offset of a block of at least `size` bytes, or None if there is none."""
        size = -(-size // BLOCK_ALIGNMENT) * BLOCK_ALIGNMENT
        kept = self._kept.get(size)
        offset = kept.pop() if kept else self._first_fit(size)
        if offset is None and self._merge_kept():
            offset = self._first_fit(size)
        if offset is not None:
            self._sizes[offset] = size
        return offset

    def free(self, offset: int) -> None:
        """Take a block back.

        Raises:
            KeyError: no such block is handed out.
        """
        size = self._sizes.pop(offset)
        self._kept.setdefault(size, []).append(offset)

    def _first_fit(self, size: int) -> int | None:
        for index, (offset, free) in enumerate(self._extents):
            if free > size:
                self._extents[index] = (offset + size, free - size)
                return offset
            if free == size:
                del self._extents[index]
                return offset
        return None

    def _merge_kept(self) -> bool:
        """Turn kept blocks into extents, joined with free neighbours; False if none was kept."""
        blocks = [(offset, size) for size, offsets in self._kept.items() for offset in offsets]
        self._kept.clear()
        for block in blocks:
            insort(self._extents, block)
        joined: list[tuple[int, int]] = []
        for offset, size in self._extents:
            if joined and sum(joined[-1]) == offset:
                joined[-1] = (joined[-1][0], joined[-1][1] + size)
            else:
                joined.append((offset, size))
        self._extents = joined
        return bool(blocks)
