"""Frames in a stream of bytes from a device: where they begin, and which are damaged."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

Frame = TypeVar("Frame")


class DamagedFrame(ValueError):
    """These bytes are no frame of the protocol: a checksum, a length or a field is wrong."""


class Framing(ABC, Generic[Frame]):
    """How one protocol marks its frames.

    Attributes:
        start: the bytes that every frame begins with.
        head_bytes: how many bytes at a frame's start `length` may need.
    """

    start: bytes
    head_bytes: int

    def find(self, buffer: bytearray, position: int) -> int:
        """Return where the next frame may begin, at or after a position; -1: nowhere."""
        return buffer.find(self.start, position)

    @abstractmethod
    def length(self, head: bytes) -> int | None:
        """Return the length of the whole frame that begins with `head`; None if `head` is still too short.

        The length must have an upper bound, because the decoder waits until that number of bytes has arrived.

        Raises:
            DamagedFrame: no frame begins like this.
        """

    @abstractmethod
    def parse(self, frame: bytes) -> Frame:
        """Return the contents of a whole frame.

        Raises:
            DamagedFrame: the checksum or the contents are wrong.
        """


@dataclass(frozen=True)
class _Candidate(Generic[Frame]):
    """A place where a frame begins, as far as its bytes have arrived."""

    begin: int
    end: int
    frame: Frame | None
    damaged: int


class FrameDecoder(Generic[Frame]):
    """Cuts a stream of bytes into frames and skips whatever is no frame.

    After damage the decoder searches from the very next byte, so it loses no intact frame. A damaged length
    could make it wait for bytes that never come: it gives such a frame up as soon as two intact frames
    follow its start.

    Example:
        ```python
        decoder = FrameDecoder(UbxFraming())
        for message in decoder.feed(port.read()):
            ...
        ```

    Attributes:
        frames: number of intact frames.
        damaged: number of damaged frames.
        skipped_bytes: number of bytes outside of intact frames.
    """

    def __init__(self, framing: Framing[Frame]) -> None:
        self.framing = framing
        self.frames = 0
        self.damaged = 0
        self.skipped_bytes = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Add received bytes; return the frames that are now complete, in order."""
        self._buffer += data
        frames: list[Frame] = []
        position = 0
        while position < len(self._buffer):
            candidate = self._first_at(position)
            if candidate.frame is not None:
                self._count(position, candidate)
                position = candidate.end
                frames.append(candidate.frame)
                continue
            # An unfinished frame may have a damaged length.
            whole = self._two_behind(candidate.begin + 1)
            if not whole:
                self._count(position, candidate)
                position = candidate.begin
                break
            self.damaged += 1
            for found in whole:
                self._count(position, found)
                position = found.end
                if found.frame is not None:
                    frames.append(found.frame)
        del self._buffer[:position]
        self.frames += len(frames)
        return frames

    def reset(self) -> None:
        """Forget an unfinished frame, for example after the device was silent."""
        self.skipped_bytes += len(self._buffer)
        self._buffer.clear()

    def _count(self, position: int, candidate: _Candidate[Frame]) -> None:
        self.skipped_bytes += candidate.begin - position
        self.damaged += candidate.damaged

    def _first_at(self, position: int) -> _Candidate[Frame]:
        """Return the first frame at or after a position, whole or unfinished; else the end of the bytes."""
        framing, buffer, damaged = self.framing, self._buffer, 0
        begin = position
        while True:
            begin = framing.find(buffer, begin)
            if begin < 0:
                return _Candidate(self._end_without_start(position), len(buffer), None, damaged)
            try:
                length = framing.length(bytes(buffer[begin : begin + framing.head_bytes]))
                if length is None or begin + length > len(buffer):
                    return _Candidate(begin, len(buffer), None, damaged)
                frame = framing.parse(bytes(buffer[begin : begin + length]))
                return _Candidate(begin, begin + length, frame, damaged)
            except DamagedFrame:
                damaged += 1
                begin += 1

    def _end_without_start(self, position: int) -> int:
        """Return the end of the bytes, before the part of a start that may stand there."""
        start, end = self.framing.start, len(self._buffer)
        for length in range(min(len(start) - 1, end - position), 0, -1):
            if self._buffer.endswith(start[:length]):
                return end - length
        return end

    def _two_behind(self, position: int) -> list[_Candidate[Frame]]:
        """Return two whole frames at or after a position; nothing if there are fewer."""
        found: list[_Candidate[Frame]] = []
        while len(found) < 2:
            candidate = self._first_at(position)
            if candidate.frame is not None:
                found.append(candidate)
                position = candidate.end
            elif candidate.begin + 1 < len(self._buffer):
                position = candidate.begin + 1
            else:
                return []
        return found
