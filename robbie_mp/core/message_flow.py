"""What becomes of messages: entered in the books, sent to who wants them, counted, let go.

Each step can be repeated after a crash of the core; why, is the ledger's affair.
"""

from collections.abc import Sequence, Set

from robbie_mp.core.directory import Channel, Directory, Subscription
from robbie_mp.core.freed_blocks import FreedBlocks
from robbie_mp.core.ledger import Handle, Ledger, Outcome
from robbie_mp.core.link import Link, ProtocolViolation, Slot
from robbie_mp.core.queues import Queues
from robbie_mp.core.recovery import unclaimed
from robbie_mp.transport import layout
from robbie_mp.transport.ring import Record
from robbie_mp.transport.words import WORD_MAX, Words, row_writer

# Looked up once, not for every message: each look-up costs as much as what is done with it.
_CORE_LAST_SEQUENCE, _PUBLISHER_ROUTED = layout.CORE_LAST_SEQUENCE, layout.PUBLISHER_ROUTED
_SOURCE_SLOT = layout.SOURCE_SLOT
_SOURCE_OF_INCARNATION = layout.SOURCE_OF_INCARNATION
_LARGEST_OFFSET = WORD_MAX >> 1
_new_tuple = tuple.__new__  # a named tuple's own constructor takes twice as long


class MessageFlow:
    """Takes each message from its publisher to all who want it, and back.

    Args:
        words: the core segment.
        message_bytes: the largest message there may be.
        ledger: every message and reference there is.
        directory: who wants what.
        queues: what waits for each module.
        blocks: the way back of memory.
    """

    def __init__(
        self,
        words: Words,
        message_bytes: int,
        ledger: Ledger,
        directory: Directory,
        queues: Queues,
        blocks: FreedBlocks,
    ):
        self._words = words
        self._write_channel = row_writer(words, 4)
        self._message_bytes = message_bytes
        self._ledger = ledger
        self._directory = directory
        self._queues = queues
        self._blocks = blocks
        self.sequence = 0
        """Of the last message: the one order of the run."""

    def publish(self, slot: Slot, link: Link, record: Record) -> None:
        """Enter a message in the books and send it on.

        Raises:
            ProtocolViolation: it is not one that this module may publish.
        """
        _, declaration, source, offset, size, stamp, block, _ = record
        channel = link.channels.get(declaration)
        if channel is None or source & _SOURCE_OF_INCARNATION != link.source:
            raise ProtocolViolation(f"it published on declaration {declaration} from source {source:#x}")
        if size > self._message_bytes or offset > _LARGEST_OFFSET:
            raise ProtocolViolation(f"it published {size} bytes at offset {offset}")
        subscriptions = channel.subscriptions
        ledger = self._ledger
        if not ledger.has_room(len(subscriptions)):
            self._refuse(slot, link, block)
            return
        handle = _new_tuple(Handle, (self.sequence + 1, source, offset, size, channel.index, stamp, block))
        index = ledger.open_handle(handle, link.outbound.tail, slot.routed + 1, channel)
        self._route(slot, channel, index, handle, subscriptions)

    def _route(
        self, slot: Slot, channel: Channel, index: int, handle: Handle, subscriptions: Sequence[Subscription]
    ) -> None:
        """Send an entered message to everyone who wants it, or queue it for them, and count it."""
        ledger, words, add = self._ledger, self._words, self._queues.add
        sequence, _, _, size, _, stamp_ns, _ = handle
        self.sequence = words[_CORE_LAST_SEQUENCE] = sequence
        claims = ledger.open_references(subscriptions, index)
        for subscription, reference in claims:
            add(subscription, reference, handle)
        slot.routed = words[slot.at + _PUBLISHER_ROUTED] = slot.routed + 1
        channel.count(self._write_channel, size, stamp_ns)
        if not claims and not ledger.is_held(index):
            self._blocks.give_back(index)

    def _refuse(self, slot: Slot, link: Link, block: int) -> None:
        """Count a message for which the tables have no row, and give its block back."""
        words, at = self._words, slot.at
        slot.refused += 1
        words[at + layout.PUBLISHER_REFUSED_NTH] = slot.refused
        words[at + layout.PUBLISHER_REFUSED_INCARNATION] = link.incarnation
        words[at + layout.PUBLISHER_REFUSED_RECORD] = link.outbound.tail
        words[at + layout.PUBLISHER_REFUSED] = slot.refused  # commits
        self._blocks.free(link, block)

    def done(self, slot: Slot, link: Link, record: Record) -> None:
        """Handled, but held: the credit comes back, the block does not."""
        reference = record[1]
        if reference not in link.pushed or self._ledger.reference(reference)[0] != record[2]:
            if link.is_said_again():
                return
            raise ProtocolViolation(f"it is done with reference {reference}, which it does not have")
        del link.pushed[reference]
        handle = self._ledger.handle(self._ledger.reference(reference)[1])
        link.in_flight[handle.source & _SOURCE_SLOT] -= handle.size
        link.pinned.add(reference)
        self._ledger.count(reference, Outcome.DELIVERED)
        self._queues.pump(slot, link)
        self._queues.outdate(slot)

    def release(self, slot: Slot, link: Link, record: Record) -> None:
        """Let go of a message; it counts as delivered now, if it did not before."""
        reference = record[1]
        ledger = self._ledger
        if reference in link.pushed and (entry := ledger.reference(reference))[0] == record[2]:
            del link.pushed[reference]
            _, source, _, size, _, _, _ = ledger.handle(entry[1])
            link.in_flight[source & _SOURCE_SLOT] -= size
            ledger.deliver(reference, entry[1], entry[2])
        elif reference in link.pinned and ledger.reference(reference)[0] == record[2]:
            link.pinned.remove(reference)
            ledger.close_reference(reference)
        elif not link.is_said_again():
            raise ProtocolViolation(f"it released reference {reference}, which it does not have")
        if slot.waiting:
            self._queues.pump(slot, link)
        self._queues.outdate(slot)

    # -- after a crash of the core -----------------------------------------------------------------------

    def finish_routing(self, slots: Sequence[Slot], handles: Sequence[int]) -> None:
        """Bring the last message that was entered to its end: it may have been cut short.

        Args:
            slots: the modules.
            handles: rows of all messages.
        """
        ledger = self._ledger
        index = max(handles, key=lambda row: ledger.handle(row).sequence, default=None)
        if index is None:
            return
        handle = ledger.handle(index)
        slot = slots[layout.unpack_source(handle.source)[0]]
        channel = self._directory.by_index(handle.channel)
        messages = ledger.row(index, layout.HANDLE_CHANNEL_MESSAGES)
        total_bytes = ledger.row(index, layout.HANDLE_CHANNEL_BYTES)
        if slot.routed < ledger.row(index, layout.HANDLE_PUBLISHER_ROUTED):
            self._route(slot, channel, index, handle, unclaimed(ledger, self._directory, index, channel))
        elif channel.messages < messages or channel.bytes < total_bytes:
            channel.messages, channel.bytes = messages - 1, total_bytes - handle.size
            channel.count(self._write_channel, handle.size, handle.stamp_ns)

    def finish_publishing(self, slot: Slot, link: Link, entered: Set[tuple[int, int, int]]) -> None:
        """Take the record at a ring's tail if it is a message that was entered or refused.

        Args:
            slot: of the publisher.
            link: to the publisher.
            entered: slot, incarnation and record of what was.
        """
        record = (link.incarnation, link.outbound.tail)
        if (link.slot, *record) in entered:
            link.outbound.take()
        elif slot.refused_record == record and link.outbound.waiting():
            self._blocks.free(link, link.outbound.peek()[6])
            link.outbound.take()
