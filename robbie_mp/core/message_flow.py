"""What becomes of messages: entered in the books, sent to who wants them, counted, let go.

Each step can be repeated after a crash of the core; why, is the ledger's affair.
"""

from collections.abc import Mapping, Sequence

from robbie_mp.core.directory import Channel, Directory, Subscription
from robbie_mp.core.freed_blocks import FreedBlocks
from robbie_mp.core.ledger import Handle, Ledger, Outcome
from robbie_mp.core.link import Link, ProtocolViolation, Slot
from robbie_mp.core.queues import Queues
from robbie_mp.core.recovery import unclaimed
from robbie_mp.transport import layout
from robbie_mp.transport.records import Outbound
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
        tag = refused_tag(link)
        # A core that died over this record may have counted it already.
        if tag != slot.refused_tag or not link.is_said_again():
            slot.refused += 1
            slot.refused_tag = tag
            self._words[slot.at + layout.PUBLISHER_REFUSED] = slot.refused << layout.REFUSED_TAG_BITS | tag
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

    def finish_publishing(self, slot: Slot, link: Link, entered: Mapping[tuple[int, int, int], int]) -> None:
        """Bring the record at a ring's tail to its end if it is a message that was entered or refused."""
        if link.has_ended or not link.outbound.waiting() or link.outbound.peek()[0] != Outbound.PUBLISH:
            return
        if slot.refused_tag == refused_tag(link):
            self._refuse(slot, link, link.outbound.peek()[6])
            link.outbound.take()
            return
        index = entered.get((link.slot, link.incarnation, link.outbound.tail))
        if index is None:
            return
        nth = self._ledger.row(index, layout.HANDLE_PUBLISHER_ROUTED)
        sequence = self._ledger.row(index, layout.HANDLE_SEQUENCE)
        if 0 < sequence < self.sequence:
            # Cut short under an earlier core, which found the ring destroyed: others have come since.
            link.outbound.take()
        elif sequence:
            handle = self._ledger.handle(index)
            channel = self._directory.by_index(handle.channel)
            slot.routed = nth - 1
            channel.messages = self._ledger.row(index, layout.HANDLE_CHANNEL_MESSAGES) - 1
            channel.bytes = self._ledger.row(index, layout.HANDLE_CHANNEL_BYTES) - handle.size
            left = unclaimed(self._ledger, self._directory, index, channel)
            self._route(slot, channel, index, handle, left)
            link.outbound.take()
        elif slot.routed >= nth:
            link.outbound.take()  # routed to its end, and even given back


def refused_tag(link: Link) -> int:
    """Name the record at the tail of a link's outbound ring in few bits."""
    return (link.incarnation & 0xFF) << 16 | link.outbound.tail & 0xFFFF
