"""The parts of the core's private state that C may take the place of; here they are Python's own.

`native_router` has the ones in C, on which the fast path in C and the Python of the core work together.
"""

from collections import OrderedDict
from collections.abc import Iterable, MutableSequence
from typing import Any, TypeVar

from robbie_mp.bus.transport.ring import NumberRingWriter, RingPlace, RingReader, RingWriter

Part = TypeVar("Part")


class Books:
    """Makes the parts of slots, links, channels and subscriptions."""

    is_wanting = True
    """Whether some module may have been asked to post when it releases a message."""

    def of(self, part: type[Part]) -> type[Part]:
        """Return the class to use for a class of the core."""
        return part

    def enter(self, subscription: Any) -> None:
        """Note which subscription has a row of the tables."""

    def queue(self) -> OrderedDict[int, int]:
        """Make a queue of references, which may be put back in front, each with a number."""
        return OrderedDict()

    def references(self) -> dict[int, int]:
        """Make a collection of references, each with a number, in the order in which they are entered."""
        return {}

    def numbers(self, values: Iterable[int]) -> MutableSequence[int]:
        """Make a list of numbers that will keep its length."""
        return list(values)

    def reader(self, place: RingPlace) -> RingReader:
        """Make the reading end of a ring."""
        return RingReader(place)

    def writer(self, place: RingPlace) -> RingWriter:
        """Make the writing end of a ring."""
        return RingWriter(place)

    def number_writer(self, place: RingPlace) -> NumberRingWriter:
        """Make the writing end of a ring of numbers."""
        return NumberRingWriter(place)
