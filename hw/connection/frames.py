"""Finds frames in a stream of bytes, and the next one after a damaged one."""

from abc import ABC, abstractmethod


class NotAFrame(ValueError):
    """These bytes are not the beginning of a frame, though the marker is there."""


class FrameReader(ABC):
    """Cuts a stream into frames that begin with a marker, tell their length, and end in a checksum.

    After a damaged frame the search goes on one byte after its marker. So a frame that stands in what a
    damaged one seemed to cover is found, too, and a marker in a payload costs nothing.

    Args:
        marker: the first bytes of each frame.
        head_bytes: how many bytes tell the length, marker included.
        max_bytes: length of the longest frame. Keep it small: a damaged length makes the reader wait for
            this many bytes at most.
    """

    def __init__(self, marker: bytes, head_bytes: int, max_bytes: int) -> None:
        self.marker, self.head_bytes, self.max_bytes = marker, head_bytes, max_bytes
        self.damaged = 0
        """Markers that no valid frame followed."""
        self.skipped_bytes = 0
        """Bytes that belonged to no valid frame."""
        self._buffer = bytearray()

    @abstractmethod
    def length(self, head: bytes) -> int:
        """Return the length of the whole frame that begins with `head` (`head_bytes` bytes).

        Raises:
            NotAFrame: no frame begins so.
        """

    @abstractmethod
    def is_valid(self, frame: bytes) -> bool:
        """Return whether a frame's checksum is right."""

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes in pieces of any length; return the valid frames that are whole now."""
        self._buffer += data
        frames, at = [], 0
        while (found := self._next(at)) is not None:
            at, frame = found
            if frame:
                frames.append(frame)
        keep = self._start_of_next(at)
        self.skipped_bytes += keep - at
        del self._buffer[:keep]
        return frames

    def forget(self) -> None:
        """Forget half a frame, for example because the port was closed."""
        self.skipped_bytes += len(self._buffer)
        self._buffer.clear()

    def _next(self, at: int) -> tuple[int, bytes] | None:
        """Return where to go on, and a frame if one is there; None: more bytes are needed."""
        start = self._buffer.find(self.marker, at)
        if start < 0 or len(self._buffer) - start < self.head_bytes:
            return None
        self.skipped_bytes += start - at
        try:
            length = self.length(bytes(self._buffer[start : start + self.head_bytes]))
            if not self.head_bytes <= length <= self.max_bytes:
                raise NotAFrame
        except NotAFrame:
            return self._behind(start)
        if len(self._buffer) - start < length:
            self.skipped_bytes -= start - at
            return None
        frame = bytes(self._buffer[start : start + length])
        return (start + length, frame) if self.is_valid(frame) else self._behind(start)

    def _behind(self, start: int) -> tuple[int, bytes]:
        self.damaged += 1
        self.skipped_bytes += 1
        return start + 1, b""

    def _start_of_next(self, at: int) -> int:
        """Return from where on bytes may belong to a frame that is not whole yet."""
        start = self._buffer.find(self.marker, at)
        if start >= 0:
            return start
        # The last bytes may be the first of a marker.
        for length in range(min(len(self.marker) - 1, len(self._buffer) - at), 0, -1):
            if self._buffer.endswith(self.marker[:length]):
                return len(self._buffer) - length
        return len(self._buffer)
