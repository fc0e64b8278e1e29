"""Rings of records between two processes: one writes the head and the records, the other the tail.

Head and tail count records and never wrap in practice (64 bits); they lie in segments of different writers.
"""

from dataclasses import dataclass

from robbie_mp.errors import RobbieError
from robbie_mp.transport.layout import RECORD_WORDS
from robbie_mp.transport.words import Fence, Words

Record = tuple[int, int, int, int, int, int, int]
"""What a ring carries: seven words. The eighth numbers the record, so that a reader sees a torn one."""


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
        self._head_at = place.head_at
        self._records_at = place.records_at
        self._mask = place.capacity - 1
        self._capacity = place.capacity
        self._tail_words = place.tail_words
        self._tail_at = place.tail_at
        self._fence = Fence()
        self.head = place.words[place.head_at]

    def room(self) -> int:
        """Records that can be pushed now."""
        return self._capacity - (self.head - self._tail_words[self._tail_at])

    def push(self, a: int, b: int, c: int, d: int, e: int, f: int, g: int) -> None:
        """Append one record; the caller has asked for `room()` first."""
        words = self._words
        head = self.head
        at = self._records_at + (head & self._mask) * RECORD_WORDS
        words[at] = a
        words[at + 1] = b
        words[at + 2] = c
        words[at + 3] = d
        words[at + 4] = e
        words[at + 5] = f
        words[at + 6] = g
        head += 1
        words[at + 7] = head
        self._fence()
        words[self._head_at] = head
        self.head = head


class RingReader:
    """The reading end."""

    def __init__(self, place: RingPlace):
        self._words = place.words
        self._head_at = place.head_at
        self._records_at = place.records_at
        self._mask = place.capacity - 1
        self._capacity = place.capacity
        self._tail_words = place.tail_words
        self._tail_at = place.tail_at
        self._fence = Fence()
        self.tail = place.tail_words[place.tail_at]

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
        words = self._words
        at = self._records_at + (self.tail & self._mask) * RECORD_WORDS
        if words[at + 7] != self.tail + 1:
            raise RingCorrupt(f"record {self.tail} of a ring is numbered {words[at + 7]}")
        return (
            words[at],
            words[at + 1],
            words[at + 2],
            words[at + 3],
            words[at + 4],
            words[at + 5],
            words[at + 6],
        )

    def take(self) -> None:
        """Advance the tail: the record was read, its place may be written again."""
        self._fence()
        self.tail += 1
        self._tail_words[self._tail_at] = self.tail


class NumberRingWriter:
    """A ring of single numbers, as the freed blocks are: the writing end.

    It asks for no room: the reader sees to it that there are never more numbers than the ring holds.
    """

    def __init__(self, place: RingPlace):
        self._words = place.words
        self._head_at = place.head_at
        self._numbers_at = place.records_at
        self._mask = place.capacity - 1
        self._fence = Fence()
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
        self._fence = Fence()
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
