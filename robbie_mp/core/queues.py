"""The queues: what waits for each module, and what has been sent to it."""

from collections.abc import Sequence

from robbie_mp.core.directory import Subscription
from robbie_mp.core.ledger import Handle, Ledger, Outcome
from robbie_mp.core.link import Link, Slot
from robbie_mp.transport import layout
from robbie_mp.transport.records import Inbound
from robbie_mp.transport.words import WORD_BYTES, Words, row_writer

# Looked up once, not for every message.
_DELIVER = int(Inbound.DELIVER)
_SOURCE_SLOT = layout.SOURCE_SLOT


class Queues:
    """Sends each module its messages in the one order, as far as its credit goes, in number and in bytes.

    Args:
        words: the core segment, for the figures.
        ledger: every reference there is.
        slots: the modules.
    """

    def __init__(self, words: Words, ledger: Ledger, slots: Sequence[Slot]):
        self._words = words
        self._ledger = ledger
        self._slots = slots
        self._write_figures = row_writer(words, 4)
        self.holds_posts = False
        """Whether more messages are about to follow, so that modules are better woken for all of them."""
        self.to_post: set[Link] = set()
        """Modules that have been sent something and are to be woken."""
        self.not_empty: set[Slot] = set()
        """Modules for which messages wait."""
        self._outdated: set[Slot] = set()
        """Modules whose figures are to be written again; always the same set, which `outdate` is bound to."""
        self.outdate = self._outdated.add
        """Note that what waits for a module, or what it has, has changed."""

    def add(self, subscription: Subscription, reference: int, handle: Handle) -> None:
        """Send a message on if nothing is before it, else let it wait; the oldest goes if too many wait."""
        slot = self._slots[subscription.slot]
        link = slot.link
        if (
            link is not None
            and link.ready
            and not slot.waiting
            and (not link.pushed or self._may_follow(subscription, handle, link))
        ):
            self._push(subscription, reference, handle, link)
            if self.holds_posts:
                self.to_post.add(link)
            else:
                link.wake()
        else:
            self._queue(slot, subscription, reference, handle.size)
        self.outdate(slot)

    def _queue(self, slot: Slot, subscription: Subscription, reference: int, size: int) -> None:
        if subscription.newest_only:
            if (old := subscription.queued) is not None:
                self.remove(slot, old)
                self._ledger.finish(old, Outcome.REPLACED)
            subscription.queued = reference
        slot.waiting[reference] = size
        slot.waiting_bytes += size
        self.not_empty.add(slot)
        if slot.link is not None and slot.link.ready:
            self.pump(slot, slot.link)
        while len(slot.waiting) > 1 and (
            len(slot.waiting) > slot.queue_messages or slot.waiting_bytes > slot.queue_bytes
        ):
            oldest = next(iter(slot.waiting))
            self.remove(slot, oldest)
            self._ledger.finish(oldest, Outcome.DROPPED)

    def remove(self, slot: Slot, reference: int) -> None:
        """Take a message out of the queue."""
        slot.waiting_bytes -= slot.waiting.pop(reference)
        if not slot.waiting:
            self.not_empty.discard(slot)
        subscription = self._ledger.reference(reference)[2]
        if subscription.queued == reference:
            subscription.queued = None

    def pump(self, slot: Slot, link: Link) -> None:
        """Push waiting messages in order, as far as the module's credit goes."""
        waiting = slot.waiting
        sent = False
        while waiting:
            reference = next(iter(waiting))
            _, index, subscription = self._ledger.reference(reference)
            handle = self._ledger.handle(index)
            if link.pushed and not self._may_follow(subscription, handle, link):
                break
            self.remove(slot, reference)
            self._push(subscription, reference, handle, link)
            sent = True
        if sent:
            self.to_post.add(link)

    def _may_follow(self, subscription: Subscription, handle: Handle, link: Link) -> bool:
        """Whether a module that has messages may be given one more: by their number and their bytes.

        It asks for the newest by being done with what it has, and then gets what is the newest by then. One
        message of each publisher it may have in any case, however large that is.
        """
        if subscription.newest_only or len(link.pushed) >= link.credit:
            return False
        publisher = handle[1] & _SOURCE_SLOT
        in_flight = link.in_flight[publisher]
        return not in_flight or in_flight + handle[3] <= link.windows[publisher]

    def _push(self, subscription: Subscription, reference: int, handle: Handle, link: Link) -> None:
        sequence, source, offset, size, channel, stamp, _ = handle
        inbound = link.inbound
        link.pushed[reference] = record = inbound.head
        link.in_flight[source & _SOURCE_SLOT] += size
        self._ledger.mark_pushed(reference, record)
        inbound.push(
            _DELIVER | subscription.declaration << 8 | channel << 32,
            reference, sequence, source, offset, size, stamp,
        )  # fmt: skip

    def put_back(self, slot: Slot, reference: int) -> None:
        """Put a message that its module never began to handle back in front of the queue."""
        _sequence, handle, subscription = self._ledger.reference(reference)
        if subscription.newest_only:
            if subscription.queued is not None:  # a newer one waits already
                self._ledger.finish(reference, Outcome.REPLACED)
                return
            subscription.queued = reference
        self._ledger.mark_waiting(reference)
        size = self._ledger.handle(handle).size
        slot.waiting[reference] = size
        slot.waiting.move_to_end(reference, last=False)
        slot.waiting_bytes += size
        self.not_empty.add(slot)

    def post(self) -> None:
        """Wake the modules that have been sent something."""
        while self.to_post:
            self.to_post.pop().wake()

    def end_round(self) -> None:
        """Do what is left when everything in the rings has been handled."""
        if self.to_post:
            self.post()
        self.write_figures()

    def is_settled(self) -> bool:
        """Whether no module has a message or will get one; only queues in lockstep can tell."""
        return False

    def restore(self) -> None:
        """Find out, as a new core, for whom messages wait."""
        self.not_empty = {slot for slot in self._slots if slot.waiting}

    def write_figures(self) -> None:
        """Show what waits for the modules, and what they have, to whoever watches."""
        words = self._words
        while self._outdated:
            slot = self._outdated.pop()
            link, waiting = slot.link, len(slot.waiting)
            self._write_figures(
                (slot.at + layout.PUBLISHER_WAITING) * WORD_BYTES,
                waiting,
                slot.waiting_bytes,
                len(link.pushed) if link else 0,
                len(link.pinned) if link else 0,
            )
            if waiting > slot.waiting_peak:
                slot.waiting_peak = waiting
                words[slot.at + layout.PUBLISHER_WAITING_PEAK] = waiting
