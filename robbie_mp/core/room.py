"""A publisher short of memory gets room: its oldest messages that nobody has begun to handle are dropped."""

from collections.abc import Container, Sequence

from robbie_mp.core.ledger import Ledger, Outcome
from robbie_mp.core.link import Link, Slot
from robbie_mp.core.queues import Queues
from robbie_mp.transport.blocks import block_bytes
from robbie_mp.transport.ring import Record


class RoomMaker:
    """Drops messages from the queues of slow subscribers before they cost the publisher new ones.

    Only a message that waits for all who still want it is dropped: one that somebody has in his ring, in his
    hands or pinned would keep its memory all the same.

    Args:
        ledger: every message and reference there is.
        queues: what waits for the modules.
        slots: the modules.
    """

    def __init__(self, ledger: Ledger, queues: Queues, slots: Sequence[Slot]):
        self._ledger = ledger
        self._queues = queues
        self._slots = slots

    def make_room(self, _slot: Slot, link: Link, record: Record) -> None:
        """Drop a module's oldest messages that only wait, until few enough with few enough bytes are left.

        What the record bounds is what is left and not what goes. So when a core that takes over handles it
        again, it drops no more than the one that died over it would have.
        """
        _, messages, memory_bytes, before_ns, *_ = record
        ledger = self._ledger
        live = ledger.live_of(link.source)
        sizes = [block_bytes(ledger.handle(index).size) for index in live]
        left, left_bytes = len(live), sum(sizes)
        if left <= messages and left_bytes <= memory_bytes:
            return
        waiting = self._waiting(frozenset(live))
        for index, size in zip(live, sizes, strict=True):
            if ledger.handle(index).stamp_ns >= before_ns:
                return
            references = waiting.get(index, [])
            if references and len(references) == ledger.holders(index):
                for slot, reference in references:
                    self._queues.remove(slot, reference)
                    ledger.finish(reference, Outcome.DROPPED)
                    self._queues.outdate(slot)
                left, left_bytes = left - 1, left_bytes - size
                if left <= messages and left_bytes <= memory_bytes:
                    return

    def _waiting(self, handles: Container[int]) -> dict[int, list[tuple[Slot, int]]]:
        """Find the references to some messages that wait, by message, each with whom it waits for."""
        found: dict[int, list[tuple[Slot, int]]] = {}
        for slot in self._slots:
            for reference in slot.waiting:
                handle = self._ledger.reference(reference)[1]
                if handle in handles:
                    found.setdefault(handle, []).append((slot, reference))
        return found
