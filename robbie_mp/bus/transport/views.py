"""Read-only maps of other modules' data segments."""

from collections.abc import Callable
from typing import Any

from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.segment import Segment


class SegmentViews:
    """Maps each data segment once, at its first message.

    Args:
        attach: maps the segment with a given slot, incarnation and number, read-only.
        native: what is written in C; None: Python does it.

    Attributes:
        mapped: the segments as C sees them, by the sources that name them.
    """

    def __init__(self, attach: Callable[[int, int, int], Segment], native: Native | None = None):
        self._attach = attach
        self._native = native
        self.mapped: dict[int, Any] = {}
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
            if self._native is not None:
                self.mapped[source] = self._native.MappedSegment(segment.buffer)
        return segment.buffer[offset : offset + size]

    def free_bytes(self, source: int) -> int:
        """Return the free memory of the publisher of a mapped segment, as of its last use of the segment."""
        return self._segments[source].words[layout.DATA_FREE_BYTES]

    def drop(self, slot: int, incarnation: int) -> None:
        """Unmap all segments of a dead publisher."""
        for source in list(self._segments):
            owner, _, of_incarnation = layout.unpack_source(source)
            if (owner, of_incarnation) == (slot, incarnation):
                self.mapped.pop(source, None)
                self._segments.pop(source).close()

    def close(self) -> None:
        """Unmap everything."""
        self.mapped.clear()
        for segment in self._segments.values():
            segment.close()
        self._segments.clear()
