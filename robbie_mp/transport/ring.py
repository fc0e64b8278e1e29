"""Rings of records between two processes: one writes the head and the records, the other the tail.

Head and tail count records and never wrap in practice (64 bits); they lie in segments of different writers.
"""

from dataclasses import dataclass

from robbie_mp.errors import RobbieError
from robbie_mp.transport.layout import RECORD_WORDS
from robbie_mp.transport.words import WORD_BYTES, Words, new_fence, row_reader, row_writer

Record = tuple[int, ...]
"""What a ring carries: seven words, and an eighth that numbers the record: so a reader sees a torn one."""

_RECORD_BYTES = RECORD_WORDS * WORD_BYTES


@dataclass(frozen=True)
class RingPlace:
    """Where a ring lies: the head and the records in the writer's segment, the tail in the reader's."""

    words: Words
    head_at: int
    records_at: int
    capacity: int
    """Number of records, a power of two."""
    tail_words: Words
    tail_at: int


class RingCorrupt(RobbieError, ValueError):
    """A ring holds what its writer cannot have put there.

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
        """Records that can be pushed now."""
        return self._capacity - (self.head - self._tail_words[self._tail_at])

    def push(self, a: int, b: int, c: int, d: int, e: int, f: int, g: int) -> None:
        """Append one record; the caller has asked for `room()` first."""
        head = self.head
        at = self._records_bytes + (head & self._mask) * _RECORD_BYTES
        head += 1
        self._write(at, a, b, c, d, e, f, g, head)
        self._fence()
        self._words[self._head_at] = head
        self.head = head


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
        """Records before this one need no other look at the head, nor a fence."""

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
        """Read the record at the tail, which `waiting()` has promised.

        Raises:
            RingCorrupt: it does not carry its own number.
        """
        tail = self.tail
        record = self._read(self._records_bytes + (tail & self._mask) * _RECORD_BYTES)
        if record[7] != tail + 1:
            raise RingCorrupt(f"record {tail} of a ring is numbered {record[7]}")
        return record

    def glance(self) -> int:
        """Return what the first word of the record at the tail seems to be; nothing is checked."""
        return self._words[self._records_bytes // WORD_BYTES + (self.tail & self._mask) * RECORD_WORDS]

    def take(self) -> None:
        """Advance the tail: the record was read, its place may be written again."""
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
        # What `peek` and `take` do: a process that has just been woken pays dearly for each call.
        record = self._read(self._records_bytes + (tail & self._mask) * _RECORD_BYTES)
        if record[7] != tail + 1:
            raise RingCorrupt(f"record {tail} of a ring is numbered {record[7]}")
        self._fence()
        self.tail = self._tail_words[self._tail_at] = tail + 1
        return record


class NumberRingWriter:
    """A ring of single numbers, as the freed blocks are: the writing end.

    It asks for no room: the reader sees to it that there are never more numbers than the ring holds.
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


class NumberRingReader:
    """A ring of single numbers: the reading end."""

    def __init__(self, place: RingPlace):
        self._words = place.words
        self._head_at = place.head_at
        self._numbers_at = place.records_at
        self._mask = place.capacity - 1
        self._tail_words = place.tail_words
        self._tail_at = place.tail_at
        self._fence = new_fence()
        self.tail = place.tail_words[place.tail_at]

    def take_all(self) -> list[int]:
        """Take every number that waits."""
        head = self._words[self._head_at]
        if head == self.tail:
            return []
        self._fence()
        numbers = [self._words[self._numbers_at + (at & self._mask)] for at in range(self.tail, head)]
        self._fence()
        self.tail = head
        self._tail_words[self._tail_at] = head
        return numbers
