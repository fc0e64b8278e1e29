"""Handles what modules declare: their channels, their subscriptions, and the end of their setup."""

from collections.abc import Sequence

from robbie_mp.core.directory import Directory, Subscription
from robbie_mp.core.ledger import Ledger, Outcome
from robbie_mp.core.members import Link, Slot
from robbie_mp.core.queues import Queues
from robbie_mp.transport import layout
from robbie_mp.transport.records import MessageHandling
from robbie_mp.transport.ring import Record
from robbie_mp.transport.words import Words


class Declarations:
    """Handles the records ADVERTISE, SUBSCRIBE and READY, and closes subscriptions.

    Args:
        words: the core segment.
        slots: the modules.
        ledger: all references.
        directory: all channels and subscriptions.
        queues: the queues of the modules.
    """

    def __init__(
        self, words: Words, slots: Sequence[Slot], ledger: Ledger, directory: Directory, queues: Queues
    ):
        self._words = words
        self._slots = slots
        self._ledger = ledger
        self._directory = directory
        self._queues = queues

    def on_advertise(self, _slot: Slot, link: Link, record: Record) -> None:
        """Open a channel."""
        row = link.declaration(record[1])
        channel = self._directory.channel(row.name, link.slot)
        self._directory.note_publisher(channel, link.slot)
        link.channels = {**link.channels, record[1]: channel}

    def on_subscribe(self, _slot: Slot, link: Link, record: Record) -> None:
        """Open a subscription, or continue the one of an earlier incarnation."""
        row = link.declaration(record[1])
        entry = self._directory.subscribe(link.slot, row.name, MessageHandling(row.handling))
        entry.declaration = row.number
        entry.declared_by = link.incarnation

    def on_ready(self, slot: Slot, link: Link, _record: Record) -> None:
        """Start sending messages to a module; close earlier subscriptions that it has not declared again."""
        link.ready = True
        self._words[slot.at + layout.PUBLISHER_READY] = link.incarnation
        for entry in list(self._directory.subscriptions):
            if entry.slot == link.slot and entry.declared_by != link.incarnation and entry.is_open:
                self._close(entry, Outcome.DROPPED)
        self._queues.pump(slot, link)

    def close_all(self, slot: int, outcome: Outcome) -> None:
        """Close all subscriptions of a module that will not come back."""
        for entry in [entry for entry in self._directory.subscriptions if entry.slot == slot]:
            self._close(entry, outcome)

    def _close(self, entry: Subscription, outcome: Outcome) -> None:
        slot = self._slots[entry.slot]
        if outcome is Outcome.DROPPED:
            self._directory.note_end(entry)
        for reference in list(slot.waiting):
            if self._ledger.reference(reference)[2] is entry:
                self._queues.remove(slot, reference)
                self._ledger.finish(reference, outcome)
        self._directory.close(entry)
        self._queues.outdate(slot)
