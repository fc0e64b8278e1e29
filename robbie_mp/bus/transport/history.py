"""What a module has handled: a bounded ring of records in shared memory that outlives the module's death.

The module writes: each message and tick before it is handled, and everything else that decides what its code
does next, such as the clock's answers. The oldest records are overwritten. The reader gets the bytes of the
segment and trusts none of them.
"""

import json
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
from robbie_mp.bus.transport.words import WORD_BYTES, WORD_MAX, Words

HEAD_BYTES = HISTORY_RECORD_WORDS * WORD_BYTES
LARGEST_SHARE = 16
"""A record that is larger than this part of the ring is written without its data."""
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
    """A number of the port, whether it was written; the bytes that crossed it."""
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


class HistoryWriter(Protocol):
    """Adds to the history; C has a class with this interface."""

    def append(
        self, kind: int, time_ns: int = 0, a: int = 0, b: int = 0, c: int = 0, d: int = 0, data: Any = b"", /
    ) -> None:
        """Append an event, or without its data if they are too large."""

    def close(self) -> None:
        """Let go of the memory."""

    def disown(self) -> None:
        """Record nothing in a forked process."""


class PythonHistory:
    """Writes records as C does; see `HistoryWriter`.

    Args:
        words: the history segment.
    """

    def __init__(self, words: memoryview):
        self._words: Words = words
        self._ring = words[HISTORY_RING:].cast("B")
        self._capacity = len(self._ring)

    def append(
        self, kind: int, time_ns: int = 0, a: int = 0, b: int = 0, c: int = 0, d: int = 0, data: Any = b"", /
    ) -> None:
        """Append an event, or without its data if they are too large."""
        if not self._capacity:
            return
        size = memoryview(data).nbytes
        whole = HEAD_BYTES + (size + 7 & ~7)
        if whole > self._capacity // LARGEST_SHARE:
            whole = HEAD_BYTES
        words = self._words
        head = words[layout.HISTORY_HEAD]
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
        self._capacity = 0
        self._ring.release()

    def disown(self) -> None:
        """Record nothing in a forked process."""
        self._capacity = 0


def history_words(ring_bytes: int) -> int:
    """Size of a history segment in words."""
    return HISTORY_RING + ring_bytes // WORD_BYTES


class OwnHistory:
    """The history of this process.

    Args:
        segment: the history segment.
        native: what is written in C; None: Python does it.

    Attributes:
        bytes: size of the ring.
        random_recorded_s: when the state of the generators of random numbers was recorded last.
        writer: appends to it, also in C.
        append: the same.
    """

    def __init__(self, segment: Segment, native: Native | None):
        words = memoryview(segment.buffer).cast("Q")
        self._words = words
        self.bytes = (len(words) - HISTORY_RING) * WORD_BYTES
        self.random_recorded_s = float("-inf")
        self.writer: Any = PythonHistory(words) if native is None else native.History(words)
        self.append: Callable[..., None] = self.writer.append
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
    capacity, head = len(ring), words[layout.HISTORY_HEAD]
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
