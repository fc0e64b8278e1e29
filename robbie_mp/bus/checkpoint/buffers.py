"""The two shared-memory segments between which a module's checkpoints alternate.

They outlive the module's incarnations.

Only the segment without the newest checkpoint is ever written, replaced or removed. So the newest complete
checkpoint stays intact whenever the process is killed. If the state has grown, that same segment is removed
and created again, larger, under the same name. The next incarnation reads after the supervisor has reaped the
dead process, so it sees everything that process stored.
"""

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass

from robbie_mp.base.linux.forks import REFUSED, keep_from_forks
from robbie_mp.bus.checkpoint.errors import CheckpointDamaged, CheckpointTooLarge, CheckpointTooNew
from robbie_mp.bus.checkpoint.image import Checkpoint, ImageLayout, decode, read_header
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.layout import CHECKPOINT_IMAGE, CHECKPOINT_SEQUENCE, SegmentKind
from robbie_mp.bus.transport.segment import Segment, SegmentMismatch, SegmentMissing, unlink_segment
from robbie_mp.bus.transport.words import WORD_BYTES

IMAGE_BEGIN = CHECKPOINT_IMAGE * WORD_BYTES
MAX_COPIES = 10
"""How often a checkpoint is copied that its module replaces meanwhile."""
SUPERSEDED = 1 << 63
"""Marks the sequence of a checkpoint that has a newer one, so that the loss of the newer one is noticed."""


@dataclass(frozen=True)
class CheckpointCopy:
    """A copy of a checkpoint: its encoding, and when it was taken, in ns since 1970."""

    image: bytes
    taken_ns: int


def newest_checkpoint(run_id: str, slot: int) -> CheckpointCopy | None:
    """Copy the newest checkpoint of a module while that goes on; None if there is none that can be read.

    Args:
        run_id: the run.
        slot: that of the module.
    """
    for _ in range(MAX_COPIES):
        copies = [_copied(names.checkpoint(run_id, slot, number)) for number in (0, 1)]
        for _, image in sorted((copy for copy in copies if copy is not None), reverse=True):
            with suppress(CheckpointDamaged):  # the module has written a newer one meanwhile
                return CheckpointCopy(image, decode(image).taken_ns)
            break
    return None


def _copied(name: str) -> tuple[int, bytes] | None:
    """Return sequence and image of a segment that somebody else may be writing."""
    try:
        segment = Segment.attach(name, SegmentKind.CHECKPOINT)
    except (SegmentMissing, SegmentMismatch):
        return None
    with closing(segment):
        sequence = segment.words[CHECKPOINT_SEQUENCE] & ~SUPERSEDED
        image = bytes(segment.buffer[IMAGE_BEGIN:])
    try:
        return (sequence, image[: read_header(memoryview(image), len(image)).size]) if sequence else None
    except (CheckpointDamaged, CheckpointTooNew):
        return None


class CheckpointBuffers:
    """The checkpoints of one module, in its current process.

    Args:
        run_id, slot, incarnation: identify the module's incarnation.
        limit_bytes: maximum size of one checkpoint.
        is_expected: whether an earlier incarnation has saved a checkpoint.

    Attributes:
        found: the newest valid checkpoint of earlier incarnations; None if there is none.
        damaged: what was wrong with newer checkpoints; empty if `found` is the last one that was completed.
    """

    def __init__(
        self, run_id: str, slot: int, incarnation: int, limit_bytes: int, *, is_expected: bool = False
    ):
        self._name = names.checkpoint(run_id, slot, 0), names.checkpoint(run_id, slot, 1)
        self._owner = slot, incarnation
        self._limit_bytes = limit_bytes
        self._lock = threading.Lock()
        self._held: Segment | None = None
        self.found: Checkpoint | None = None
        self.damaged: list[str] = []
        unreadable: list[str] = []
        self._segments = [self._attached(name, unreadable) for name in self._name]
        self._newest = 0
        self._sequence = 0
        self._read_newest(unreadable)
        if is_expected and self.found is None and not self.damaged:
            self.damaged.append("this run has saved checkpoints of the module, and none is left")
        keep_from_forks(self)

    def disown(self) -> None:
        """In a forked process: refuse to write, because that would overwrite the parent's checkpoint."""
        self._lock = REFUSED

    def write(self, state: ImageLayout, taken_ns: int) -> None:
        """Store a state; the previous checkpoint stays valid until this one is complete.

        Args:
            state: the layout of the state.
            taken_ns: the time, ns since 1970.

        Raises:
            CheckpointTooLarge: the state is larger than the limit; the previous checkpoint stays.
            SharedMemoryFull: there is no memory for it; the previous checkpoint stays.
        """
        if state.size > self._limit_bytes:
            raise CheckpointTooLarge(
                f"a checkpoint of {state.size} bytes exceeds this module's limit of {self._limit_bytes}; "
                "raise memory.checkpoint_bytes in the profile, or store less"
            )
        number = 1 - self._newest
        segment = self._segment_with_room(number, state.size)
        segment.words[CHECKPOINT_SEQUENCE] = 0
        state.write(segment.buffer[IMAGE_BEGIN:], self._sequence + 1, taken_ns)
        segment.words[CHECKPOINT_SEQUENCE] = self._sequence + 1
        before = self._segments[self._newest]
        if before is not None and before.words[CHECKPOINT_SEQUENCE]:
            before.words[CHECKPOINT_SEQUENCE] |= SUPERSEDED
        with self._lock:
            self._newest = number
            self._sequence += 1

    @contextmanager
    def newest(self) -> Iterator[memoryview]:
        """Hold the image of the newest checkpoint for one other thread; it does not change meanwhile.

        Raises:
            LookupError: there is no checkpoint.
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
    def _attached(name: str, unreadable: list[str]) -> Segment | None:
        try:
            return Segment.attach(name, SegmentKind.CHECKPOINT, write=True)
        except SegmentMissing:  # there is none, or its process was killed before it was complete
            return None
        except SegmentMismatch as error:
            unreadable.append(str(error))
            return None

    def _read_newest(self, unreadable: list[str]) -> None:
        """Find the newest checkpoint that is valid, and what was wrong with newer ones."""
        complete = [
            (word & ~SUPERSEDED, number, segment, not word & SUPERSEDED)
            for number, segment in enumerate(self._segments)
            if segment is not None and (word := segment.words[CHECKPOINT_SEQUENCE]) & ~SUPERSEDED
        ]
        for sequence, number, segment, is_last in sorted(complete, reverse=True):
            try:
                found = decode(segment.buffer[IMAGE_BEGIN:])
                if found.sequence != sequence:
                    raise CheckpointDamaged(f"checkpoint {sequence} says that it is {found.sequence}")
            except (CheckpointDamaged, CheckpointTooNew) as error:
                # Keeping the error would keep the memory mapped.
                (self.damaged if is_last else unreadable).append(str(error))
                continue
            self.found, self._newest, self._sequence = found, number, sequence
            if is_last:
                return
            break
        self.damaged += unreadable
        if self.found is not None and not self.damaged:
            self.damaged.append(f"the one after checkpoint {self._sequence} is gone")

    def _segment_with_room(self, number: int, size: int) -> Segment:
        """Return a segment to write into; a new one if the existing one is too small or held."""
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
