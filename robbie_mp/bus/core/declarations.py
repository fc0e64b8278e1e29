"""Handles what modules declare: their channels, their subscriptions, and the end of their setup."""

from collections.abc import Callable, Sequence

from robbie_mp.bus.core.directory import Directory, Subscription
from robbie_mp.bus.core.ledger import Ledger
from robbie_mp.bus.core.members import Link, Slot, name_of
from robbie_mp.bus.core.queues import Queues
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import MessageHandling
from robbie_mp.bus.transport.ring import Record
from robbie_mp.bus.transport.tables import Outcome
from robbie_mp.bus.transport.words import Words


class Declarations:
    """Handles the records ADVERTISE, SUBSCRIBE and READY, and closes subscriptions.

    Args:
        words: the core segment.
        slots: the modules.
        ledger: all references.
        directory: all channels and subscriptions.
        queues: the queues of the modules.
        report: called with a line for each latched message that a module does not get.
    """

    def __init__(
        self,
        words: Words,
        slots: Sequence[Slot],
        ledger: Ledger,
        directory: Directory,
        queues: Queues,
        report: Callable[[str], None],
    ):
        self._words = words
        self._slots = slots
        self._ledger = ledger
        self._directory = directory
        self._queues = queues
        self._report = report

    def on_advertise(self, _slot: Slot, link: Link, record: Record) -> None:
        """Open a channel."""
        row = link.declaration(record[1])
        channel = self._directory.channel(row.name, link.slot)
        self._directory.note_publisher(channel, link.slot)
        if row.is_latched:
            self._directory.latch(channel, link.slot)
        link.channels = {**link.channels, record[1]: channel}

    def on_subscribe(self, slot: Slot, link: Link, record: Record) -> None:
        """Open a subscription, or continue the one of an earlier incarnation.

        If its module has finished its setup before, it gets what is kept of latched channels now. Nothing is
        pushed until the record has been taken, so if the core dies, its successor finds what was given.
        """
        row = link.declaration(record[1])
        entry = self._directory.subscribe(link.slot, row.name, MessageHandling(row.handling))
        entry.declaration = row.number
        entry.declared_by = link.incarnation
        if link.ready:
            self._queues.trim(slot, self._give(slot, link, entry))

    def on_ready(self, slot: Slot, link: Link, _record: Record) -> None:
        """Start sending messages to a module; close earlier subscriptions that it has not declared again.

        First it gets what is kept of latched channels. Nothing is pushed before the word that says that it is
        ready, and nothing is given after it. So if the core dies meanwhile, its successor finds what was
        given.
        """
        given: list[int] = []
        if self._words[slot.at + layout.PUBLISHER_READY] != link.incarnation:
            mine = [entry for entry in self._directory.subscriptions if entry.slot == link.slot]
            for entry in mine:
                if entry.declared_by != link.incarnation and entry.is_open:
                    self._close(entry, Outcome.DROPPED)
            for entry in mine:
                if entry.is_open:
                    given += self._give(slot, link, entry)
            self._words[slot.at + layout.PUBLISHER_READY] = link.incarnation
        link.ready = True
        self._queues.pump(slot, link)
        self._queues.trim(slot, frozenset(given))

    def _give(self, slot: Slot, link: Link, entry: Subscription) -> list[int]:
        """Let a subscription wait for the newest message of each latched channel that it does not have.

        Returns:
            The references, which wait in the module's queue; nothing is pushed.
        """
        latches = self._directory.latches(entry)
        if not latches:
            return []
        ledger, words = self._ledger, self._words
        kept = sorted(ledger.reference(latch.queued)[:2] for latch in latches if latch.queued is not None)
        kept = [one for one in kept if not self._is_withheld(link, entry, one[0])]
        if entry.newest_only:
            waits_for = 0 if entry.queued is None else ledger.reference(entry.queued)[0]
            kept = [(sequence, handle) for sequence, handle in kept[-1:] if sequence > waits_for]
        live = map(ledger.reference, (*slot.waiting, *link.pushed, *link.pinned))
        has = {handle for _, handle, subscription in live if subscription is entry}
        given = []
        for _, handle in kept:
            if handle in has:
                continue
            if not ledger.has_free_reference():
                words[layout.CORE_NOT_GIVEN] = words[layout.CORE_NOT_GIVEN] + 1
                continue
            if words[layout.CORE_SETTLED]:
                words[layout.CORE_SETTLED] = 0  # in lockstep: there is something to handle
            reference = ledger.open_late_reference(entry, handle)
            self._queues.add_late(slot, entry, reference, ledger.handle(handle).size)
            given.append(reference)
        return given

    def _is_withheld(self, link: Link, entry: Subscription, sequence: int) -> bool:
        """Whether a module no longer gets a latched message, over which two of its incarnations died."""
        withheld = self._directory.is_withheld(entry, sequence)
        if withheld:
            self._report(
                f"{name_of(link.slot, link.incarnation)} no longer gets latched message {sequence} for its "
                f"subscription to {entry.type_name} on topic '{entry.topic}': it died over it twice"
            )
        return withheld

    def close_all(self, slot: int, outcome: Outcome) -> None:
        """Close all subscriptions of a module that will not come back."""
        for entry in [entry for entry in self._directory.subscriptions if entry.slot == slot]:
            self._close(entry, outcome)
        self.forget_deaths(slot)

    def forget_deaths(self, slot: int) -> None:
        """Give a module that comes back as ordered all latched messages again; may be repeated."""
        for entry in self._directory.subscriptions:
            if entry.slot == slot:
                self._directory.forget_deaths(entry)

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
