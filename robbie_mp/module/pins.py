"""Pinned messages: they have been handled, but something still refers to their memory."""

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Delivery
from robbie_mp.bus.transport.words import Words

MAX_PINNED = 256
"""Most messages of one publisher that a module pins; its handlers get copies of further ones."""
PINNED_SHARE = 8
"""Beyond its first message, a module pins at most an eighth of what the publisher has free. So n modules that
keep all they can leave the publisher 8 / (8 + n) of its memory.

A limit relative to the free memory needs no knowledge of the other modules, and always leaves some memory:
Choudhury and Hahne, Dynamic queue length thresholds for shared-memory packet switches, IEEE/ACM Transactions
on Networking 6(2), 1998.
"""


class Pins:
    """The messages that a module keeps from being released; the type of the same name in C does the same.

    Args:
        words: the module's out segment, for the counters.
    """

    def __init__(self, words: Words):
        self._words = words
        self._by_reference: dict[int, tuple[Delivery, object]] = {}
        self._publishers: dict[int, _Pinned] = {}
        """The pins of each publisher's incarnation, by the common part of its sources."""
        self._bytes = 0

    def __len__(self) -> int:
        """Return the number of pinned messages."""
        return len(self._by_reference)

    def add(self, delivery: Delivery, kept: object) -> None:
        """Pin a delivered message, with an object that is to live as long."""
        self._by_reference[delivery.reference] = delivery, kept
        self._count(delivery, 1)

    def remove(self, reference: int) -> Delivery:
        """Return the delivery of a message that is no longer pinned.

        Raises:
            KeyError: it was not.
        """
        delivery, _ = self._by_reference.pop(reference)
        self._count(delivery, -1)
        return delivery

    def have_room_for(self, delivery: Delivery, free_bytes: int) -> bool:
        """Whether the limits leave room for a message of a publisher that has this number of bytes free."""
        pinned = self._publishers.get(delivery.source & layout.SOURCE_OF_INCARNATION)
        if pinned is None:
            return True
        return pinned.messages < MAX_PINNED and PINNED_SHARE * (pinned.bytes + delivery.size) <= free_bytes

    def close(self) -> None:
        """Do nothing: that in C lets go of the memory."""

    def _count(self, delivery: Delivery, change: int) -> None:
        """Count a message that is now pinned (1), or no longer (-1)."""
        publisher = delivery.source & layout.SOURCE_OF_INCARNATION
        pinned = self._publishers.setdefault(publisher, _Pinned())
        pinned.messages += change
        pinned.bytes += change * delivery.size
        if not pinned.messages:
            del self._publishers[publisher]
        self._bytes += change * delivery.size
        self._words[layout.OUT_PINNED] = len(self._by_reference)
        self._words[layout.OUT_PINNED_BYTES] = self._bytes


class _Pinned:
    """The messages of one incarnation of a publisher that a module pins."""

    __slots__ = ("bytes", "messages")

    def __init__(self) -> None:
        self.messages = 0
        self.bytes = 0
