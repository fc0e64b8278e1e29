"""Simulated runs over the test build's memory: C and Python store into it through the same fuse."""

from types import ModuleType

from robbie_mp.bus.transport.words import Words
from tests.bus.core._support.memory import ClosableWords, Died, Fuse, StateLog


class FusedMemory:
    """Words of the test build.

    Args:
        built: the test build.
        with_c: whether the run is to use the hot path in C.
    """

    def __init__(self, built: ModuleType, *, with_c: bool):
        self._built = built
        self.native = built if with_c else None

    def fuse(self) -> Fuse:
        fuse: Fuse = self._built.Fuse(Died)
        return fuse

    def zeros(self, count: int) -> Words:
        words: Words = self._built.Words(count)
        return words

    def map(
        self, words: Words, fuse: Fuse, segment: object = None, log: StateLog | None = None
    ) -> ClosableWords:
        assert isinstance(words, self._built.Words)
        words.fuse = fuse
        if log is not None:
            words.watch(lambda index, old, new: log.stored(segment, index, old, new))
        return self.look_at(words)

    def look_at(self, words: Words) -> ClosableWords:
        assert isinstance(words, self._built.Words)
        mapped: ClosableWords = words.map()
        return mapped

    def note_wake(self, slot: int) -> None:
        self._built.note_wake(slot)
