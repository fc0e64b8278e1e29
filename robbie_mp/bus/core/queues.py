"""The queues: messages that wait for each module, and messages that have been sent to it.

`Queues` serves an ordinary run. In lockstep `LockstepQueues` delivers one message at a time in the whole run;
see `robbie_mp.module.lockstep`.
"""

from collections.abc import Callable, Container, Sequence, Set

from robbie_mp.bus.core.directory import Channel, Subscription
from robbie_mp.bus.core.ledger import Handle, Ledger
from robbie_mp.bus.core.members import Link, Slot
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import CHANNEL_SHIFT, DECLARATION_SHIFT, Inbound
from robbie_mp.bus.transport.tables import Outcome
from robbie_mp.bus.transport.words import WORD_BYTES, Words, row_writer

# Looked up once, not for every message.
_DELIVER = int(Inbound.DELIVER)
_SOURCE_SLOT = layout.SOURCE_SLOT
_WAITING_PEAK = layout.PUBLISHER_WAITING_PEAK


class Queues:
    """Sends each module its messages in global order, up to its credit in messages and in bytes.

    Args:
        words: the core segment, for the figures.
        ledger: all references.
        slots: the modules.
    """

    def __init__(self, words: Words, ledger: Ledger, slots: Sequence[Slot]):
        self._words = words
        self._ledger = ledger
        self._slots = slots
        self._write_figures = row_writer(words, 4)
        self.holds_posts = False
        """Whether more messages are about to follow, so that one post may wake a module for all of them."""
        self.to_post: dict[Link, None] = {}
        """Modules that have been sent records and have not been woken yet; `note_post` is bound to it."""
        self.note_post: Callable[[Link], None] = self.to_post.setdefault
        """Have a module be woken, for it has been sent records."""
        self._outdated: dict[Slot, None] = {}
        """Modules whose figures must be written again; `outdate` is bound to it."""
        self.outdate: Callable[[Slot], None] = self._outdated.setdefault
        """Note that the queue of a module, or the messages it has, have changed."""

    def add(self, subscription: Subscription, reference: int, handle: Handle, channel: Channel) -> None:
        """Send a message, or queue it behind others; if the queue is full, drop its oldest message."""
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
                self.note_post(link)
            else:
                link.wake()
        else:
            if slot.yields:
                self._yield_to_pace(slot, reference, handle, channel)
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
        if slot.link is not None and slot.link.ready:
            self.pump(slot, slot.link)
        while len(slot.waiting) > 1 and (
            len(slot.waiting) > slot.queue_messages or slot.waiting_bytes > slot.queue_bytes
        ):
            oldest = next(iter(slot.waiting))
            self.remove(slot, oldest)
            self._ledger.finish(oldest, Outcome.DROPPED)

    def add_late(self, slot: Slot, subscription: Subscription, reference: int, size: int) -> None:
        """Queue a message that is older than others in the queue at its place in the order; push nothing."""
        ledger = self._ledger
        if subscription.newest_only:
            if (old := subscription.queued) is not None:
                self.remove(slot, old)
                ledger.finish(old, Outcome.REPLACED)
            subscription.queued = reference
        sequence = ledger.reference(reference)[0]
        later = [other for other in slot.waiting if ledger.reference(other)[0] > sequence]
        slot.waiting[reference] = size
        slot.waiting_bytes += size
        for other in later:
            slot.waiting.move_to_end(other)
        self.outdate(slot)

    def trim(self, slot: Slot, spared: Container[int]) -> None:
        """Drop the oldest messages of a queue that is too long, the spared ones only if no other is left."""
        ledger = self._ledger
        droppable = sorted(
            slot.waiting, key=lambda reference: reference in spared
        )  # stable: the oldest first
        for reference in droppable[:-1]:
            if len(slot.waiting) <= slot.queue_messages and slot.waiting_bytes <= slot.queue_bytes:
                return
            self.remove(slot, reference)
            ledger.finish(reference, Outcome.DROPPED)
            self.outdate(slot)

    def _yield_to_pace(self, slot: Slot, reference: int, handle: Handle, channel: Channel) -> None:
        """Before a message is queued: drop what waits of its channel, if its publisher paces itself.

        So such a publisher waits for what is in the ring of the black box, and for one message of each
        channel; the black box gets as much as it can handle, and always the newest.
        """
        publisher = self._alive(handle.source)
        if publisher is None or not publisher.paces:
            return
        old, ledger = channel.paced_reference, self._ledger
        if (
            old in slot.waiting
            and ledger.reference(old)[0] == channel.paced_sequence
            and self._alive(ledger.handle(ledger.reference(old)[1]).source) is not None
        ):
            self.remove(slot, old)
            ledger.finish(old, Outcome.DROPPED)
        channel.paced_reference, channel.paced_sequence = reference, handle.sequence

    def _alive(self, source: int) -> Link | None:
        """Return the link of a message's publisher; None: it is dead."""
        link = self._slots[source & _SOURCE_SLOT].link
        return link if link is not None and link.source == source & layout.SOURCE_OF_INCARNATION else None

    def remove(self, slot: Slot, reference: int) -> None:
        """Take a message out of the queue."""
        slot.waiting_bytes -= slot.waiting.pop(reference)
        subscription = self._ledger.reference(reference)[2]
        if subscription.queued == reference:
            subscription.queued = None

    def pump(self, slot: Slot, link: Link) -> None:
        """Push waiting messages in order, up to the module's credit."""
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
            self.note_post(link)

    def _may_follow(self, subscription: Subscription, handle: Handle, link: Link) -> bool:
        """Whether a module that has messages may be sent one more, by their number and their bytes.

        A subscription that keeps only the newest gets it when the module has handled all it has. One message
        of each publisher is always allowed, however large it is.
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
            _DELIVER | subscription.declaration << DECLARATION_SHIFT | channel << CHANNEL_SHIFT,
            reference, sequence, source, offset, size, stamp,
        )  # fmt: skip

    def put_back(self, slot: Slot, reference: int) -> None:
        """Put a message that its dead module had not begun to handle back in front of the queue."""
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

    def somebody_waits(self) -> bool:
        """Whether messages wait for a module that is connected."""
        return any(slot.waiting and slot.link is not None for slot in self._slots)

    def post(self) -> None:
        """Wake the modules that have been sent records, in that order."""
        for link in self.to_post:
            link.wake()
        self.to_post.clear()

    def end_round(self) -> None:
        """Wake modules and write figures, at the end of each round over the rings."""
        if self.to_post:
            self.post()
        self.write_figures()

    def is_settled(self) -> bool:
        """Whether no module has a message or will get one; only LockstepQueues knows."""
        return False

    def write_figures(self) -> None:
        """Write the length of the queues, and the number of messages that modules have, for observers."""
        words = self._words
        for slot in self._outdated:
            link, waiting = slot.link, len(slot.waiting)
            self._write_figures(
                (slot.at + layout.PUBLISHER_WAITING) * WORD_BYTES,
                waiting,
                slot.waiting_bytes,
                len(link.pushed) if link else 0,
                len(link.pinned) if link else 0,
            )
            peak_at = slot.at + _WAITING_PEAK
            peak = words[peak_at]
            if waiting > peak:
                words[peak_at] = waiting
        self._outdated.clear()


class LockstepQueues(Queues):
    """Sends the oldest waiting message to its module as soon as no module has a message.

    The messages that a handler publishes are in the ledger before the release of the message it handled, as
    both come through one ring. If several modules subscribe to a message, the first one in the profile gets
    it first. If a module is just being restarted, the others wait for it.

    Args:
        words: the core segment, for the figures.
        ledger: all references.
        slots: the modules.
        tools: slots of tools, of the supervisor and of the core, which are not waited for.
        now_ns: the run's time, if modules are charged for the time that their handlers take: then a module
            gets no message while it is still busy. None: handlers take no time of the run.
    """

    def __init__(
        self,
        words: Words,
        ledger: Ledger,
        slots: Sequence[Slot],
        tools: Set[int],
        now_ns: Callable[[], int] | None = None,
    ):
        super().__init__(words, ledger, slots)
        self._now_ns = now_ns
        self._in_step = [slot for slot in slots if slot.index not in tools]
        self._tools = tools

    def add(self, subscription: Subscription, reference: int, handle: Handle, channel: Channel) -> None:
        """Queue a message; if the queue is full, drop its oldest message."""
        if subscription.slot in self._tools:
            super().add(subscription, reference, handle, channel)
            return
        slot = self._slots[subscription.slot]
        self._queue(slot, subscription, reference, handle.size)
        self.outdate(slot)

    def pump(self, slot: Slot, link: Link) -> None:
        """Push nothing to modules: `end_round` does that, after all records of the round were handled."""
        if slot.index in self._tools:
            super().pump(slot, link)

    def end_round(self) -> None:
        """Send the next message if no module has one."""
        if not self._is_anyone_busy():
            self._hand_out()
        super().end_round()

    def is_settled(self) -> bool:
        """Whether no module has a message, or will get one at the present time."""
        return not self._is_anyone_busy() and not self._ready_for_messages()

    def _ready_for_messages(self) -> list[Slot]:
        """Return the modules with messages waiting that are not busy by the run's time."""
        waiting = [slot for slot in self._in_step if slot.waiting]
        if self._now_ns is None or not waiting:
            return waiting
        now_ns = self._now_ns()
        return [slot for slot in waiting if not _is_charged(slot, now_ns)]

    def _is_anyone_busy(self) -> bool:
        return any(slot.link is not None and self._is_busy(slot.link) for slot in self._in_step)

    def _is_busy(self, link: Link) -> bool:
        """Whether a module has a message of an open subscription.

        A module that hangs in the kernel and cannot be killed keeps its messages for good; its subscriptions
        are closed.
        """
        return any(self._ledger.reference(reference)[2].is_open for reference in link.pushed)

    def _hand_out(self) -> None:
        waiting = self._ready_for_messages()
        if not waiting:
            return
        slot = min(waiting, key=self._next_sequence)  # of equal ones, the first in the profile
        link = slot.link
        if link is None or not link.ready:
            return
        reference = next(iter(slot.waiting))
        _, handle, subscription = self._ledger.reference(reference)
        self.remove(slot, reference)
        self._push(subscription, reference, self._ledger.handle(handle), link)
        self.note_post(link)
        self.outdate(slot)

    def _next_sequence(self, slot: Slot) -> int:
        return self._ledger.reference(next(iter(slot.waiting)))[0]


def _is_charged(slot: Slot, now_ns: int) -> bool:
    """Whether a module is still busy with its last message, by the run's time."""
    if slot.link is None:
        return False
    words = slot.link.out_words
    since_ns = words[layout.OUT_CHARGED_SINCE_NS]
    return since_ns <= now_ns < since_ns + words[layout.OUT_CHARGED_NS]
