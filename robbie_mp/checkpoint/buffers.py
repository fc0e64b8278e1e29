"""Two shared-memory segments that a module's checkpoints alternate between; they outlive its incarnations.

Only the segment that does not hold the newest checkpoint is ever written, replaced or removed, so whatever
the process is killed at, the newest one that was complete stays as it is. A larger state needs nothing more:
that same segment is removed and made anew, larger, under its name. The next incarnation reads after the
supervisor has waited for the dead process, so it sees all that one has stored.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from robbie_mp.checkpoint.errors import CheckpointDamaged, CheckpointTooLarge, CheckpointTooNew
from robbie_mp.checkpoint.image import Checkpoint, Layout, decode, read_header
from robbie_mp.linux.forks import REFUSED, keep_from_forks
from robbie_mp.transport import names
from robbie_mp.transport.layout import CHECKPOINT_IMAGE, CHECKPOINT_SEQUENCE, SegmentKind
from robbie_mp.transport.segment import Segment, SegmentMismatch, SegmentMissing, unlink_segment
from robbie_mp.transport.words import WORD_BYTES

IMAGE_BEGIN = CHECKPOINT_IMAGE * WORD_BYTES


class CheckpointBuffers:
    """The checkpoints of one module, as its process that lives now sees them.

    Args:
        run_id, slot, incarnation: whose they are.
        limit_bytes: of one checkpoint.

    Attributes:
        found: the newest valid checkpoint of the incarnations before; None if there is none.
        damaged: what was wrong with newer ones.
    """

    def __init__(self, run_id: str, slot: int, incarnation: int, limit_bytes: int):
        self._name = names.checkpoint(run_id, slot, 0), names.checkpoint(run_id, slot, 1)
        self._owner = slot, incarnation
        self._limit_bytes = limit_bytes
        self._lock = threading.Lock()
        self._held: Segment | None = None
        self._segments = [self._attached(name) for name in self._name]
        self.found: Checkpoint | None = None
        self.damaged: list[str] = []
        self._newest = 0
        self._sequence = 0
        self._read_newest()
        keep_from_forks(self)

    def disown(self) -> None:
        """Let a forked process keep nothing: it would write over the checkpoint of who forked it."""
        self._lock = REFUSED

    def write(self, state: Layout, taken_ns: int) -> None:
        """Keep a state; the one before stays valid until this one is complete.

        Args:
            state: the state, laid out.
            taken_ns: the time, ns since 1970.

        Raises:
            CheckpointTooLarge: it is larger than the limit; the one before stays.
            SharedMemoryFull: there is no room for it; the one before stays.
        """
        if state.size > self._limit_bytes:
            raise CheckpointTooLarge(
                f"a checkpoint of {state.size} bytes is more than the {self._limit_bytes} that this "
                "module may keep; raise memory.checkpoint_bytes in the profile or keep less"
            )
        number = 1 - self._newest
        segment = self._segment_with_room(number, state.size)
        segment.words[CHECKPOINT_SEQUENCE] = 0
        state.write(segment.buffer[IMAGE_BEGIN:], self._sequence + 1, taken_ns)
        segment.words[CHECKPOINT_SEQUENCE] = self._sequence + 1
        with self._lock:
            self._newest = number
            self._sequence += 1

    @contextmanager
    def newest(self) -> Iterator[memoryview]:
        """Hold the image of the newest checkpoint, for one other thread; it stays as it is.

        Raises:
            LookupError: there is none.
        """
        with self._lock:
            segment = self._held = self._segments[self._newest]
        if segment is None or segment.words[CHECKPOINT_SEQUENCE] == 0:
            raise LookupError("there is no checkpoint yet")
        try:
            with segment.buffer[IMAGE_BEGIN:] as room, room[: read_header(room, len(room)).size] as image:
                yield image
        finally:
            with self._lock:
                self._held = None
                if segment not in self._segments:
                    segment.close()

    def close(self) -> None:
        """Unmap the segments; they stay for the next incarnation."""
        for segment in self._segments:
            if segment is not None:
                segment.close()

    @staticmethod
    def _attached(name: str) -> Segment | None:
        try:
            return Segment.attach(name, SegmentKind.CHECKPOINT, write=True)
        except (SegmentMissing, SegmentMismatch):  # there is none, or its maker was killed before it was one
            return None

    def _read_newest(self) -> None:
        """Find the newest checkpoint that is valid."""
        complete = [
            (segment.words[CHECKPOINT_SEQUENCE], number, segment)
            for number, segment in enumerate(self._segments)
            if segment is not None and segment.words[CHECKPOINT_SEQUENCE] != 0
        ]
        for sequence, number, segment in sorted(complete, reverse=True):
            try:
                found = decode(segment.buffer[IMAGE_BEGIN:])
                if found.sequence != sequence:
                    raise CheckpointDamaged(f"checkpoint {sequence} says that it is {found.sequence}")
            except (CheckpointDamaged, CheckpointTooNew) as error:
                self.damaged.append(str(error))  # the error itself would keep the memory mapped
                continue
            self.found, self._newest, self._sequence = found, number, sequence
            return

    def _segment_with_room(self, number: int, size: int) -> Segment:
        """Return a segment to write into; a new one if that of this number is too small or held."""
        with self._lock:
            segment = self._segments[number]
            is_held = segment is self._held
            if segment is not None and not is_held and IMAGE_BEGIN + size <= segment.size:
                return segment
            self._segments[number] = None
            if segment is not None and not is_held:
                segment.close()
        unlink_segment(self._name[number])
        room = IMAGE_BEGIN + min(size + size // 4, self._limit_bytes)
        words = -(-room // WORD_BYTES)
        made = Segment.create(self._name[number], words, SegmentKind.CHECKPOINT, *self._owner)
        self._segments[number] = made
        return made
