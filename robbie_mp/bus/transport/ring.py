"""Rings of records between two processes: one writes the records and the head, the other writes the tail.

Head and tail count records; they have 64 bits and never wrap in practice. They lie in different segments.
"""

from dataclasses import dataclass

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.layout import RECORD_WORDS
from robbie_mp.bus.transport.words import WORD_BYTES, Words, new_fence, row_reader, row_writer

Record = tuple[int, ...]
"""Seven words of a record, and an eighth with its number, by which a reader recognises a torn record."""

_RECORD_BYTES = RECORD_WORDS * WORD_BYTES


@dataclass(frozen=True)
class RingPlace:
    """Where a ring lies: head and records in the writer's segment, the tail in the reader's segment."""

    words: Words
    head_at: int
    records_at: int
    capacity: int
    """Number of records, a power of two."""
    tail_words: Words
    tail_at: int


class RingCorrupt(RobbieError, ValueError):
    """A ring holds values that a correct writer cannot have written.

    Example scenarios:
      - a wild pointer of a C library in the module wrote over its outbound segment
    """


class RingWriter:
    """The writing end."""

    def __init__(self, place: RingPlace):
        self._words = place.words
        self._write = row_writer(place.words, RECORD_WORDS)
        self._head_at = place.head_at
        self._records_bytes = place.records_at * WORD_BYTES
        self._mask = place.capacity - 1
        self._capacity = place.capacity
        self._tail_words = place.tail_words
        self._tail_at = place.tail_at
        self._fence = new_fence()
        self.head = place.words[place.head_at]

    def room(self) -> int:
        """Records that can be pushed now; none if the reader's tail is one that it cannot have."""
        room = self._capacity - (self.head - self._tail_words[self._tail_at])
        return room if 0 <= room <= self._capacity else 0

    def push(self, a: int, b: int, c: int, d: int, e: int, f: int, g: int) -> None:
        """Append one record; call `room()` first."""
        head = self.head
        at = self._records_bytes + (head & self._mask) * _RECORD_BYTES
        head += 1
        self._write(at, a, b, c, d, e, f, g, head)
        self._fence()
        self._words[self._head_at] = head
        self.head = head

    def close(self) -> None:
        """Let go of the memory, which only the ends in C hold."""


class RingReader:
    """The reading end."""

    def __init__(self, place: RingPlace):
        self._words = place.words
        self._read = row_reader(place.words, RECORD_WORDS)
        self._head_at = place.head_at
        self._records_bytes = place.records_at * WORD_BYTES
        self._mask = place.capacity - 1
        self._capacity = place.capacity
        self._tail_words = place.tail_words
        self._tail_at = place.tail_at
        self._fence = new_fence()
        self.tail = place.tail_words[place.tail_at]
        self._looked_up_to = self.tail
        """Records before this one were checked against the head, with a fence, and can be read at once."""

    def waiting(self) -> int:
        """Records that can be read now.

        Raises:
            RingCorrupt: the head is out of the ring's range.
        """
        waiting = self._words[self._head_at] - self.tail
        if not waiting:
            return 0
        if not 0 < waiting <= self._capacity:
            raise RingCorrupt(f"a ring of {self._capacity} records claims that {waiting} wait")
        self._fence()
        return waiting

    def peek(self) -> Record:
        """Read the record at the tail; call `waiting()` first.

        Raises:
            RingCorrupt: it does not carry its own number.
        """
        tail = self.tail
        record = self._read(self._records_bytes + (tail & self._mask) * _RECORD_BYTES)
        if record[7] != tail + 1:
            raise RingCorrupt(f"record {tail} of a ring is numbered {record[7]}")
        return record

    def glance(self) -> int:
        """Return the first word at the tail, unchecked: there may be no record."""
        return self._words[self._records_bytes // WORD_BYTES + (self.tail & self._mask) * RECORD_WORDS]

    def take(self) -> None:
        """Advance the tail, so that the writer may reuse the record's place."""
        self._fence()
        self.tail += 1
        self._tail_words[self._tail_at] = self.tail

    def next(self) -> Record | None:
        """Read the record at the tail and advance the tail; None if there is none.

        Raises:
            RingCorrupt: as for `waiting` and `peek`.
        """
        tail = self.tail
        if tail == self._looked_up_to:
            if self._words[self._head_at] == tail:
                return None
            self._looked_up_to = tail + self.waiting()
        # The same as `peek` and `take`, without the calls, which are slow in a process just woken.
        record = self._read(self._records_bytes + (tail & self._mask) * _RECORD_BYTES)
        if record[7] != tail + 1:
            raise RingCorrupt(f"record {tail} of a ring is numbered {record[7]}")
        self._fence()
        self.tail = self._tail_words[self._tail_at] = tail + 1
        return record

    def close(self) -> None:
        """Let go of the memory, which only the ends in C hold."""


class NumberRingWriter:
    """A ring of single numbers, such as freed blocks: the writing end.

    It does not check for room: the reader limits how many numbers can be on their way.
    """

    def __init__(self, place: RingPlace):
        self._words = place.words
        self._head_at = place.head_at
        self._numbers_at = place.records_at
        self._mask = place.capacity - 1
        self._fence = new_fence()
        self.head = place.words[place.head_at]

    def push(self, number: int) -> None:
        """Append a number."""
        self._words[self._numbers_at + (self.head & self._mask)] = number
        self._fence()
        self.head += 1
        self._words[self._head_at] = self.head

    def close(self) -> None:
        """Let go of the memory, which only the ends in C hold."""


class NumberRingReader:
    """A ring of single numbers: the reading end."""

    def __init__(self, place: RingPlace):
        self._words = place.words
        self._head_at = place.head_at
        self._numbers_at = place.records_at
        self._mask = place.capacity - 1
        self._capacity = place.capacity
        self._tail_words = place.tail_words
        self._tail_at = place.tail_at
        self._fence = new_fence()
        self.tail = place.tail_words[place.tail_at]

    def take_all(self) -> list[int]:
        """Take all numbers in the ring.

        Raises:
            RingCorrupt: the head is out of the ring's range.
        """
        head = self._words[self._head_at]
        if head == self.tail:
            return []
        if not 0 < head - self.tail <= self._capacity:
            raise RingCorrupt(f"a ring of {self._capacity} records claims that {head - self.tail} wait")
        self._fence()
        numbers = [self._words[self._numbers_at + (at & self._mask)] for at in range(self.tail, head)]
        self._fence()
        self.tail = head
        self._tail_words[self._tail_at] = head
        return numbers
