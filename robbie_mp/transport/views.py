"""Read-only maps of other modules' data segments."""

from collections.abc import Callable

from robbie_mp.transport import layout
from robbie_mp.transport.segment import Segment


class SegmentViews:
    """Maps each data segment once, at its first message.

    Args:
        attach: maps the segment with a given slot, incarnation and number, read-only.
    """

    def __init__(self, attach: Callable[[int, int, int], Segment]):
        self._attach = attach
        self._segments: dict[int, Segment] = {}

    def view(self, source: int, offset: int, size: int) -> memoryview:
        """Return the bytes of a block; shorter than `size` if the segment ends before.

        Raises:
            SegmentMissing, SegmentMismatch: there is no such data segment.
        """
        segment = self._segments.get(source)
        if segment is None:
            slot, number, incarnation = layout.unpack_source(source)
            segment = self._segments[source] = self._attach(slot, incarnation, number)
        return segment.buffer[offset : offset + size]

    def free_bytes(self, source: int) -> int:
        """Return the free memory of the publisher of a mapped segment, as of its last use of the segment."""
        return self._segments[source].words[layout.DATA_FREE_BYTES]

    def drop(self, slot: int, incarnation: int) -> None:
        """Unmap all segments of a dead publisher."""
        for source in list(self._segments):
            owner, _, of_incarnation = layout.unpack_source(source)
            if (owner, of_incarnation) == (slot, incarnation):
                self._segments.pop(source).close()

    def close(self) -> None:
        """Unmap everything."""
        for segment in self._segments.values():
            segment.close()
        self._segments.clear()
