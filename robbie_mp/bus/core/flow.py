"""The way of a message: entered in the ledger, sent to its subscribers, counted, and its block given back.

`MessageFlow` handles the records of messages, `FreedBlocks` gives blocks back to their publishers, and
`RoomMaker` drops waiting messages for a publisher that is short of memory. Each step may be repeated after a
crash of the core; `ledger` says why.
"""

from collections.abc import Container, Iterable, Sequence

from robbie_mp.bus.core.directory import Channel, Subscription
from robbie_mp.bus.core.ledger import Handle, Ledger
from robbie_mp.bus.core.members import Link, Members, ProtocolViolation, Slot
from robbie_mp.bus.core.queues import Queues
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.blocks import block_bytes
from robbie_mp.bus.transport.ring import Record
from robbie_mp.bus.transport.tables import Outcome
from robbie_mp.bus.transport.words import WORD_MAX, Words, row_reader, row_writer

# Looked up once, not for every message: each look-up costs as much as what is done with it.
_CORE_LAST_SEQUENCE, _PUBLISHER_ROUTED = layout.CORE_LAST_SEQUENCE, layout.PUBLISHER_ROUTED
_SOURCE_SLOT = layout.SOURCE_SLOT
_SOURCE_OF_INCARNATION = layout.SOURCE_OF_INCARNATION
_MAX_OFFSET = WORD_MAX >> 1
_new_tuple = tuple.__new__  # a named tuple's own constructor takes twice as long


class MessageFlow:
    """Handles the records PUBLISH, DONE and RELEASE.

    Args:
        words: the core segment.
        message_bytes: size of the largest valid message.
        ledger: all messages and references.
        queues: the queues of the modules.
        blocks: gives blocks back.
    """

    def __init__(
        self,
        words: Words,
        message_bytes: int,
        ledger: Ledger,
        queues: Queues,
        blocks: "FreedBlocks",
    ):
        self._words = words
        self._read_figures, self._write_figures = row_reader(words, 4), row_writer(words, 4)
        self._message_bytes = message_bytes
        self._ledger = ledger
        self._queues = queues
        self._blocks = blocks

    def on_publish(self, slot: Slot, link: Link, record: Record) -> None:
        """Enter a message in the ledger and route it.

        Raises:
            ProtocolViolation: this module may not publish it.
        """
        _, declaration, source, offset, size, stamp, block, _ = record
        channel = link.channels.get(declaration)
        if channel is None or source & _SOURCE_OF_INCARNATION != link.source:
            raise ProtocolViolation(f"it published on declaration {declaration} from source {source:#x}")
        if size > self._message_bytes or offset > _MAX_OFFSET:
            raise ProtocolViolation(f"it published {size} bytes at offset {offset}")
        subscriptions = channel.subscriptions
        ledger = self._ledger
        if not ledger.has_room(len(subscriptions)):
            self._refuse(slot, link, block)
            return
        words = self._words
        sequence = words[_CORE_LAST_SEQUENCE] + 1
        handle = _new_tuple(Handle, (sequence, source, offset, size, channel.index, stamp, block))
        routed = words[slot.at + _PUBLISHER_ROUTED] + 1
        figures = self._read_figures(channel.figures_at)
        index = ledger.open_handle(handle, link.outbound.tail, routed, figures[0] + 1, figures[1] + size)
        self.route(slot, channel, figures, index, handle, subscriptions)

    def route(
        self,
        slot: Slot,
        channel: Channel,
        figures: tuple[int, ...],
        index: int,
        handle: Handle,
        subscriptions: Sequence[Subscription],
    ) -> None:
        """Send an entered message to its subscribers, or queue it for them, and count it.

        Args:
            slot: its publisher.
            channel: its channel.
            figures: those of the channel without it, see `Channel.count`.
            index: its row in the table of handles.
            handle: the message.
            subscriptions: those that get it.
        """
        ledger, words, add = self._ledger, self._words, self._queues.add
        sequence, _, _, size, _, stamp_ns, _ = handle
        words[_CORE_LAST_SEQUENCE] = sequence
        claims = ledger.open_references(subscriptions, index)
        for subscription, reference in claims:
            add(subscription, reference, handle, channel)
        words[slot.at + _PUBLISHER_ROUTED] = words[slot.at + _PUBLISHER_ROUTED] + 1
        channel.count(self._write_figures, figures, size, stamp_ns)
        if not claims and not ledger.holders(index):
            self._blocks.give_back(index)

    def _refuse(self, slot: Slot, link: Link, block: int) -> None:
        """Count a message that does not fit into the tables, and give its block back."""
        words, at = self._words, slot.at
        nth = words[at + layout.PUBLISHER_REFUSED] + 1
        words[at + layout.PUBLISHER_REFUSED_NTH] = nth
        words[at + layout.PUBLISHER_REFUSED_INCARNATION] = link.incarnation
        words[at + layout.PUBLISHER_REFUSED_RECORD] = link.outbound.tail
        words[at + layout.PUBLISHER_REFUSED] = nth  # commits
        self._blocks.free(link, block)

    def on_done(self, slot: Slot, link: Link, record: Record) -> None:
        """Count a message as delivered, which frees its credit; the module still uses its block."""
        reference = record[1]
        if reference not in link.pushed or self._ledger.reference(reference)[0] != record[2]:
            if link.is_repeated():
                return
            raise ProtocolViolation(f"it is done with reference {reference}, which it does not have")
        del link.pushed[reference]
        handle = self._ledger.handle(self._ledger.reference(reference)[1])
        link.in_flight[handle.source & _SOURCE_SLOT] -= handle.size
        link.pinned[reference] = 0
        self._ledger.count(reference, Outcome.DELIVERED)
        self._queues.pump(slot, link)
        self._queues.outdate(slot)

    def on_release(self, slot: Slot, link: Link, record: Record) -> None:
        """Close a module's reference to a message; count it as delivered unless `on_done` has done so."""
        reference = record[1]
        ledger = self._ledger
        if reference in link.pushed and (entry := ledger.reference(reference))[0] == record[2]:
            del link.pushed[reference]
            _, source, _, size, _, _, _ = ledger.handle(entry[1])
            link.in_flight[source & _SOURCE_SLOT] -= size
            ledger.deliver(reference, entry[1], entry[2])
        elif reference in link.pinned and ledger.reference(reference)[0] == record[2]:
            del link.pinned[reference]
            ledger.close_reference(reference)
        elif not link.is_repeated():
            raise ProtocolViolation(f"it released reference {reference}, which it does not have")
        if slot.waiting:
            self._queues.pump(slot, link)
        self._queues.outdate(slot)


class FreedBlocks:
    """Gives a message's block back to its publisher when no reference to the message is left.

    Args:
        words: the core segment.
        ledger: all messages.
        slots: the modules.
        members: the connected modules.
    """

    def __init__(self, words: Words, ledger: Ledger, slots: Sequence[Slot], members: Members):
        self._words = words
        self._ledger = ledger
        self._slots = slots
        self._members = members
        self.dead_sources: dict[int, int] = {}
        """Live messages of each dead publisher that still has any, by its `Link.source`."""

    @property
    def are_awaited(self) -> bool:
        """Whether some module waits for freed blocks."""
        return any(link.awaited_freed for link in self._members.links)

    def give_back(self, index: int) -> None:
        """Give a message's block back to its publisher if that is alive, and then free the message's row."""
        handle = self._ledger.handle(index)
        source = handle[1] & _SOURCE_OF_INCARNATION
        link = self._slots[source & 0xFFFF].link
        if link is not None and source == link.source:
            self.free(link, handle.block)
        self._ledger.close_handle(index)
        if source in self.dead_sources:
            self.dead_sources[source] -= 1
            if not self.dead_sources[source]:
                del self.dead_sources[source]
                slot, _, incarnation = layout.unpack_source(source)
                self._members.announce_gone((slot, incarnation))

    def free(self, link: Link, block: int) -> None:
        """Give one block back."""
        link.freed.push(block)
        if 0 < link.awaited_freed <= link.freed.head:
            self.await_total(link, 0)

    def on_wait_freed(self, _slot: Slot, link: Link, record: Record) -> None:
        """Note that a module waits until a total number of its blocks has been freed."""
        link.paces = True
        self.await_total(link, record[1])

    def await_total(self, link: Link, total: int) -> None:
        """Wake a module when `total` of its blocks have ever been freed: now, or later."""
        waits = total > link.freed.head
        link.awaited_freed = total if waits else 0
        if not waits:
            link.wake()

    def mark_dead(self, slot: int, incarnation: int) -> None:
        """Note that an incarnation is dead and has been reclaimed; its messages may outlive it."""
        source = layout.pack_source(slot, 0, incarnation)
        if live := len(self._ledger.live_of(source)):
            self.dead_sources[source] = live
        else:
            self._members.announce_gone((slot, incarnation))
        if self._slots[slot].link is None:
            self._words[self._slots[slot].at + layout.PUBLISHER_LINKED] = 0


class RoomMaker:
    """Drops the oldest waiting messages of a publisher that is short of memory for new ones.

    A message is dropped only if all references to it wait in queues. If a module has been sent it or has
    pinned it, dropping the other references would not free its memory.

    Args:
        ledger: all messages and references.
        queues: the queues of the modules.
        slots: the modules, and the core's own slot last.
    """

    def __init__(self, ledger: Ledger, queues: Queues, slots: Sequence[Slot]):
        self._ledger = ledger
        self._queues = queues
        self._slots = slots
        self._latches = slots[-1]

    def on_make_room(self, _slot: Slot, link: Link, record: Record) -> None:
        """Drop a module's oldest waiting messages until few enough, with few enough bytes, are left.

        The record limits what is left, not what is dropped. So if a core dies over it and its successor
        handles it again, the two drop no more than one would have.

        The newest messages of latched channels are dropped only if that makes enough room, the largest first.
        """
        _, messages, memory_bytes, before_ns, latched_bytes, *_ = record
        ledger = self._ledger
        live = ledger.live_of(link.source)
        sizes = {index: block_bytes(ledger.size_of(index)) for index in live}
        left, left_bytes = len(live), sum(sizes.values())
        if left <= messages and left_bytes <= memory_bytes:
            return
        latched = []
        for index, references in self._droppable(live).items():
            is_young = ledger.stamp_ns_of(index) >= before_ns
            if any(slot is self._latches for slot, _ in references):
                if not is_young or len(references) == 1:  # no subscriber is about to take it
                    latched.append((index, references))
            elif not is_young and (left > messages or left_bytes > memory_bytes):
                self._drop(references)
                left, left_bytes = left - 1, left_bytes - sizes[index]
        if left_bytes - sum(sizes[index] for index, _ in latched) > latched_bytes:
            return
        latched.sort(key=lambda entry: -sizes[entry[0]])
        for index, references in latched:
            if left_bytes <= latched_bytes:
                return
            self._drop(references)
            left_bytes -= sizes[index]

    def _drop(self, references: Iterable[tuple[Slot, int]]) -> None:
        for slot, reference in references:
            self._queues.remove(slot, reference)
            self._ledger.finish(reference, Outcome.DROPPED)
            self._queues.outdate(slot)

    def _droppable(self, live: Sequence[int]) -> dict[int, list[tuple[Slot, int]]]:
        """Return the messages of which all references wait, in the given order, with these references."""
        waiting = self._waiting(frozenset(live))
        return {
            index: waiting[index]
            for index in live
            if index in waiting and len(waiting[index]) == self._ledger.holders(index)
        }

    def _waiting(self, handles: Container[int]) -> dict[int, list[tuple[Slot, int]]]:
        """Find the waiting references to some messages, by message, each with the slot of its subscriber."""
        found: dict[int, list[tuple[Slot, int]]] = {}
        handle_of = self._ledger.handle_of
        for slot in self._slots:
            for reference in slot.waiting:
                if (handle := handle_of(reference)) in handles:
                    found.setdefault(handle, []).append((slot, reference))
        return found
