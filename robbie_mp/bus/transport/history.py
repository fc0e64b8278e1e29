"""What a module has handled: a bounded ring of records in shared memory that outlives the module's death.

The module writes: each message and tick before it is handled, and everything else that decides what its code
does next, such as the clock's answers. The oldest records are overwritten. The reader gets the bytes of the
segment and trusts none of them.

The ring takes its memory piece by piece, before it is needed and while the module waits: a write to a page
that was never touched takes 3 µs, and modules that handle little need little.
"""

import json
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

from robbie_mp.base.linux.forks import keep_from_forks
from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.layout import HISTORY_RECORD_WORDS, HISTORY_RING, HISTORY_START_WORDS
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.bus.transport.words import WORD_BYTES, WORD_MAX, Words

HEAD_BYTES = HISTORY_RECORD_WORDS * WORD_BYTES
LARGEST_SHARE = 16
"""A record that is larger than this part of the ring is written without its data."""
LARGEST_KEY_SHARE = 4
"""One larger message at a time is kept, up to this part: it stands in for the others in a replay."""
LARGEST_PUBLISHED_SHARE = 256
"""The same for what the module published, which is only compared."""
GROWTH_BYTES = 1 << 16
"""The ring grows by so much, and is ready for so much."""
ROOM_FACTOR = 16
"""The ring does not grow while less than this many of it are free in /dev/shm."""
_HEAD = struct.Struct("<8Q")


class Event(IntEnum):
    """The kind of a record, and its values."""

    PADDING = 0
    """The rest of the ring before its end."""
    MESSAGE = 1
    """A message is handled: channel and declaration << 32, sequence, source, stamp; its bytes."""
    TICK = 2
    CALLS = 3
    """What is due for calls, deadlines and timers."""
    PUBLISHED = 4
    """Declaration; the bytes."""
    REFUSED = 5
    CLOCK = 6
    """A `Reading`, and what the clock answered."""
    ANSWER = 7
    """What something outside answered: JSON of the name of the question and the answer."""
    RESTORED = 8
    """The image of the checkpoint with which the module started."""
    CHECKPOINT = 9
    """The image of a checkpoint that is complete."""
    BEGUN = 10
    """The setup is over."""
    PORT = 11
    """A `PortAct` on a link to a device, its number, whether it failed; the bytes that crossed it, or why."""
    RANDOM = 12
    """The state of the generators of random numbers, JSON."""
    TEARDOWN = 13


class Reading(IntEnum):
    """What was asked of a clock."""

    NOW_NS = 0
    MONOTONIC_NS = 1
    AT = 2
    MACHINE_S_UNTIL = 3
    """The answer is the bits of a double."""
    JUMPS = 4
    MACHINE_NS = 5


class PortAct(IntEnum):
    """What was done on a link to a device."""

    OPENED = 1
    """The URL."""
    READ = 2
    WRITTEN = 3
    RATE = 4
    """The bit rate, as text."""
    MOTOR = 5
    """b'1' if the line is high."""
    DRAINED = 6
    CLOSED = 7
    SLEPT = 8
    """The driver waited; it has no number."""


class HistoryWriter(Protocol):
    """Adds to the history; C has a class with this interface."""

    def append(
        self, kind: int, time_ns: int = 0, a: int = 0, b: int = 0, c: int = 0, d: int = 0, data: Any = b"", /
    ) -> None:
        """Append an event, or without its data if they are too large."""

    def prepare(self) -> None:
        """Take memory for what comes next, while there is nothing to do."""

    def close(self) -> None:
        """Let go of the memory."""

    def disown(self) -> None:
        """Record nothing in a forked process."""


class PythonHistory:
    """Writes records as C does; see `HistoryWriter`.

    Args:
        words: the history segment.
        ready_bytes: so much of it has its memory; 0: all.
        segment: where the words are, to get it more memory.
    """

    def __init__(self, words: memoryview, ready_bytes: int = 0, segment: Segment | None = None):
        self._words: Words = words
        self._ring = words[HISTORY_RING:].cast("B")
        self._most = len(self._ring)
        self._capacity = (ready_bytes or words.nbytes) - HISTORY_RING * WORD_BYTES
        self._segment = segment
        self._key_at: int | None = None
        words[layout.HISTORY_CAPACITY] = self._capacity

    def append(
        self, kind: int, time_ns: int = 0, a: int = 0, b: int = 0, c: int = 0, d: int = 0, data: Any = b"", /
    ) -> None:
        """Append an event, or without its data if they are too large."""
        if not self._capacity:
            return
        size = memoryview(data).nbytes
        whole = HEAD_BYTES + (size + 7 & ~7)
        words = self._words
        head = words[layout.HISTORY_HEAD]
        if not self._is_kept(kind, whole):
            whole = HEAD_BYTES
        if self._capacity < self._most and head + whole > self._capacity:
            self._grow(whole)
        if whole > self._capacity:
            whole = HEAD_BYTES  # there was no room to grow
        left = self._capacity - head % self._capacity
        padding = left if left < whole else 0
        self._make_room(head, whole + padding)
        if padding:
            self._put(head, Event.PADDING | padding << 32)
            head += padding
        number = words[layout.HISTORY_RECORDS] + 1
        values = (value & WORD_MAX for value in (kind | whole << 32, number, size, time_ns, a, b, c, d))
        at = head % self._capacity
        self._ring[at : at + HEAD_BYTES] = _HEAD.pack(*values)
        if whole > HEAD_BYTES:
            self._ring[at + HEAD_BYTES : at + HEAD_BYTES + size] = memoryview(data).cast("B")
        words[layout.HISTORY_RECORDS] = number
        words[layout.HISTORY_HEAD] = head + whole

    def _is_kept(self, kind: int, whole: int) -> bool:
        """Whether the data of a record are kept."""
        if kind == Event.PUBLISHED:
            return whole <= self._most // LARGEST_PUBLISHED_SHARE
        if whole <= self._most // LARGEST_SHARE or kind != Event.MESSAGE:
            return whole <= self._most // LARGEST_SHARE
        has_key = self._key_at is not None and self._key_at >= self._words[layout.HISTORY_TAIL]
        if has_key or whole > self._most // LARGEST_KEY_SHARE:
            return False
        self._key_at = self._words[layout.HISTORY_HEAD]
        return True

    def prepare(self) -> None:
        """Take memory for what comes next, while there is nothing to do."""
        head = self._words[layout.HISTORY_HEAD] if self._capacity else 0
        if 0 < self._capacity < self._most and head + GROWTH_BYTES > self._capacity:
            self._grow(GROWTH_BYTES)

    def _grow(self, count: int) -> None:
        """Get more memory, if there is room, and if the oldest records have not been overwritten."""
        grown = min(self._most, self._capacity + -(-count // GROWTH_BYTES) * GROWTH_BYTES)
        if self._segment is None or self._words[layout.HISTORY_TAIL]:
            return
        begin = HISTORY_RING * WORD_BYTES
        if free_bytes() >= ROOM_FACTOR * grown and self._segment.populate(
            begin + self._capacity, begin + grown
        ):
            self._capacity = self._words[layout.HISTORY_CAPACITY] = grown

    def _put(self, number: int, word: int) -> None:
        self._words[HISTORY_RING + number % self._capacity // WORD_BYTES] = word

    def _make_room(self, head: int, count: int) -> None:
        tail = self._words[layout.HISTORY_TAIL]
        while head + count - tail > self._capacity:
            whole = self._words[HISTORY_RING + tail % self._capacity // WORD_BYTES] >> 32
            if not 0 < whole <= head - tail:
                tail = head
                break
            tail += whole
        self._words[layout.HISTORY_TAIL] = tail

    def close(self) -> None:
        """Let go of the memory."""
        self._capacity = self._most = 0
        self._ring.release()

    def disown(self) -> None:
        """Record nothing in a forked process."""
        self._capacity = self._most = 0


def history_words(ring_bytes: int) -> int:
    """Size of a history segment in words."""
    return HISTORY_RING + ring_bytes // WORD_BYTES


def record_nothing(*_event: object) -> None:
    """Add nothing to a history that there is not."""


def free_bytes() -> int:
    """Free shared memory."""
    found = os.statvfs(SHARED_MEMORY)
    return found.f_bavail * found.f_frsize


class OwnHistory:
    """The history of this process.

    Args:
        segment: the history segment.
        native: what is written in C; None: Python does it.

    Attributes:
        bytes: size of the ring when it has grown.
        random_recorded_s: when the state of the generators of random numbers was recorded last.
        writer: appends to it, also in C.
        append: the same.
        prepare: takes memory for what comes next, while there is nothing to do.
    """

    def __init__(self, segment: Segment, native: Native | None):
        words = memoryview(segment.buffer).cast("Q")
        self._words = words
        self.bytes = (len(words) - HISTORY_RING) * WORD_BYTES
        self.random_recorded_s = float("-inf")
        ready_bytes = segment.populated_bytes
        self.writer: HistoryWriter
        if native is None:
            self.writer = PythonHistory(words, ready_bytes, segment)
        else:
            self.writer = native.History(words, ready_bytes)
        self.append: Callable[..., None] = self.writer.append
        self.prepare = self.writer.prepare
        keep_from_forks(self)

    def disown(self) -> None:
        """Record nothing in a forked process."""
        self.writer.disown()

    @property
    def has_wrapped(self) -> bool:
        """Whether the oldest records have been overwritten."""
        return self._words[layout.HISTORY_TAIL] > 0

    def write_start(self, start: dict[str, Any]) -> None:
        """Write what the module begins with. Lists of files are left out if there is no room for all."""
        text = json.dumps(start, default=str).encode()
        if len(text) > HISTORY_START_WORDS * WORD_BYTES:
            text = json.dumps({**start, "files": {}}, default=str).encode()[
                : HISTORY_START_WORDS * WORD_BYTES
            ]
        place = self._words[layout.HISTORY_START : HISTORY_RING].cast("B")
        place[: len(text)] = text
        self._words[layout.HISTORY_START_BYTES] = len(text)

    def close(self) -> None:
        """Let go of the memory."""
        self.writer.close()


class Record(NamedTuple):
    """One record."""

    kind: Event
    number: int
    """Counts from 1 since the module's start."""
    size: int
    """Of the data, even if they are missing."""
    time_ns: int
    """The machine's monotonic time; 0: not noted."""
    values: tuple[int, int, int, int]
    data: bytes | None
    """None: too large to be kept."""


@dataclass
class FoundHistory:
    """What a dead module left.

    Attributes:
        start: what it began with; empty if that cannot be read.
        records: the newest records, oldest first.
        is_whole: whether these are all since its start.
        damage: what was wrong with the memory; '' if nothing.
    """

    start: dict[str, Any] = field(default_factory=dict)
    records: list[Record] = field(default_factory=list)
    is_whole: bool = False
    damage: str = ""


def read_history(image: bytes) -> FoundHistory:
    """Read the bytes of a history segment, which may hold anything."""
    found = FoundHistory()
    if len(image) < (HISTORY_RING + 1) * WORD_BYTES:
        found.damage = f"a history of {len(image)} bytes is none"
        return found
    words = memoryview(image)[: len(image) // WORD_BYTES * WORD_BYTES].cast("Q")
    try:
        found.start = _start(image, words[layout.HISTORY_START_BYTES])
        tail = words[layout.HISTORY_TAIL]
        for record in _records(words, tail):
            found.records.append(record)
        found.is_whole = tail == 0
    except (ValueError, RecursionError) as error:
        found.damage = str(error)
    return found


def _start(image: bytes, size: int) -> dict[str, Any]:
    begin = layout.HISTORY_START * WORD_BYTES
    text = image[begin : begin + min(size, HISTORY_START_WORDS * WORD_BYTES)]
    start = json.loads(text or "{}")
    if not isinstance(start, dict):
        raise ValueError("the text about the module's start is damaged")
    return start


def _records(words: memoryview, tail: int) -> Iterator[Record]:
    ring = words[HISTORY_RING:].cast("B")
    capacity, head = words[layout.HISTORY_CAPACITY], words[layout.HISTORY_HEAD]
    if not 0 < capacity <= len(ring) or capacity % WORD_BYTES:
        raise ValueError(f"the history has a ring of {capacity} bytes")
    if not 0 <= head - tail <= capacity:
        raise ValueError(f"the history goes from {tail} to {head} in {capacity} bytes")
    expected = None
    while tail < head:
        at = tail % capacity
        first = int.from_bytes(ring[at : at + WORD_BYTES], "little")
        kind, whole = first & 0xFFFFFFFF, first >> 32
        if whole < WORD_BYTES or whole % WORD_BYTES or whole > min(head - tail, capacity - at):
            raise ValueError(f"the record at {tail} has {whole} bytes")
        if kind != Event.PADDING:
            record = _record(ring[at : at + whole], kind, tail)
            if expected not in (None, record.number):
                raise ValueError(f"record {expected} has the number {record.number}")
            expected = record.number + 1
            yield record
        tail += whole


def _record(data: memoryview, kind: int, tail: int) -> Record:
    if len(data) < HEAD_BYTES or kind not in set(Event):
        raise ValueError(f"the record at {tail} is of kind {kind} and has {len(data)} bytes")
    _, number, size, time_ns, *values = _HEAD.unpack_from(data)
    content: bytes | None = bytes(data[HEAD_BYTES : HEAD_BYTES + size])
    if size and len(data) == HEAD_BYTES:
        content = None
    elif size > len(data) - HEAD_BYTES:
        raise ValueError(f"the record at {tail} has {size} bytes of data in {len(data)} bytes")
    return Record(Event(kind), number, size, time_ns, (values[0], values[1], values[2], values[3]), content)
