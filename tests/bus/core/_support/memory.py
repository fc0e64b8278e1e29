"""The memory of a simulated run: its stores are counted, and a process may die before one."""

import random
from array import array
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import ClassVar, Protocol

from robbie_mp.bus.transport.words import Words


class Died(Exception):
    """A process was killed between two stores."""


class Fuse:
    """Kills a process before the store with a given number, counted from its start."""

    def __init__(self) -> None:
        self.stores = 0
        self.deaths: Sequence[int] = ()
        """For each incarnation in turn: how many stores it lives to see; none lets it live."""
        self.on_store: Callable[[int], None] | None = None
        """Is told the number of each store before it."""

    def burn(self) -> None:
        if self.on_store is not None:
            self.on_store(self.stores)
        if self.deaths and self.stores >= self.deaths[0]:
            raise Died
        self.stores += 1


class StateLog:
    """Names the state of the whole run before every store of its core, so that equal states are tried once.

    Two deaths of the core that leave every word of shared memory the same, and the modules with the same
    past, have the same future. The modules of a simulated run act only while its core is idle, and what they
    do follows from what they read then. So a state is named by all words as they were whenever the core began
    to work, and as they are now. (Zobrist hashing: a random number for each word and value, combined by
    exclusive or.)
    """

    _random = random.Random(13)
    _numbers: ClassVar[dict[tuple[object, int, int], int]] = {}

    def __init__(self) -> None:
        self._words = 0
        self._past = 0
        self.before_store: list[int] = []
        """A name for the state before each store of the core since its last death."""

    def stored(self, segment: object, index: int, old: int, new: int) -> None:
        """Note a store by anybody."""
        if old != new:
            self._words ^= self._number(segment, index, old) ^ self._number(segment, index, new)

    def core_begins(self, reports: int) -> None:
        """Note that the core is about to look at the rings: the modules have acted."""
        self._past = hash((self._past, self._words, reports))

    def core_stores(self, number: int, reports: int) -> None:
        """Note that the core is about to store a word, its `number`-th, unless it dies before."""
        del self.before_store[number:]
        self.before_store.append(hash((self._past, self._words, reports)))

    def _number(self, segment: object, index: int, value: int) -> int:
        if value == 0:
            return 0
        key = (segment, index, value)
        number = self._numbers.get(key)
        if number is None:
            number = self._numbers[key] = self._random.getrandbits(64)
        return number


class ClosableWords(Words, Protocol):
    """What a process maps; looking at it after it was closed is an error."""

    def close(self) -> None: ...


class Memory(Protocol):
    """What the shared memory of a run is made of. Into each piece one process stores, which has a fuse."""

    native: ModuleType | None
    """The hot path in C, over this memory; None: the run is in Python only."""

    def fuse(self) -> Fuse: ...
    def zeros(self, count: int) -> Words: ...
    def map(
        self, words: Words, fuse: Fuse, segment: object = None, log: StateLog | None = None
    ) -> ClosableWords:
        """Return some words as the process maps them that stores into them."""
        ...

    def look_at(self, words: Words) -> ClosableWords:
        """Return some words as a process maps them that only reads them."""
        ...

    def note_wake(self, slot: int) -> None:
        """Note that the core wakes a module."""


class Mapped:
    """Words of an array as a process maps them."""

    def __init__(self, words: Words, fuse: Fuse, segment: object = None, log: StateLog | None = None):
        self._words: Words | None = words
        self._fuse = fuse
        self._segment = segment
        self._log = log

    def __getitem__(self, index: int) -> int:
        assert self._words is not None, "the map was closed"
        return self._words[index]

    def __setitem__(self, index: int, value: int) -> None:
        assert self._words is not None, "the map was closed"
        self._fuse.burn()
        if self._log is not None:
            self._log.stored(self._segment, index, self._words[index], value)
        self._words[index] = value

    def __len__(self) -> int:
        assert self._words is not None, "the map was closed"
        return len(self._words)

    def close(self) -> None:
        self._words = None


class ArrayMemory:
    """Arrays, and Python that counts the stores."""

    native: ModuleType | None = None

    def fuse(self) -> Fuse:
        return Fuse()

    def zeros(self, count: int) -> Words:
        return array("Q", bytes(8 * count))

    def map(
        self, words: Words, fuse: Fuse, segment: object = None, log: StateLog | None = None
    ) -> ClosableWords:
        return Mapped(words, fuse, segment, log)

    def look_at(self, words: Words) -> ClosableWords:
        return Mapped(words, Fuse())

    def note_wake(self, slot: int) -> None:
        """Wakes are counted by the modules."""
