"""The way back of the blocks: to their owners, who may wait for them, or be dead."""

from collections.abc import Sequence

from robbie_mp.core.ledger import Ledger
from robbie_mp.core.link import Link, Slot
from robbie_mp.core.members import Members
from robbie_mp.core.recovery import KNOWN_DEAD
from robbie_mp.transport import layout
from robbie_mp.transport.ring import Record
from robbie_mp.transport.words import Words

_SOURCE_OF_INCARNATION = layout.SOURCE_OF_INCARNATION


class FreedBlocks:
    """Gives the blocks of messages back to which nobody refers any more.

    Args:
        words: the core segment.
        ledger: every message there is.
        slots: the modules.
        members: those of them that are connected.
    """

    def __init__(self, words: Words, ledger: Ledger, slots: Sequence[Slot], members: Members):
        self._words = words
        self._ledger = ledger
        self._slots = slots
        self._members = members
        self._dead_sources: set[tuple[int, int]] = set()
        """Slot and incarnation of dead publishers whose messages are still alive."""
        self.waits = 0
        """Links that wait for freed blocks."""

    def give_back(self, index: int) -> None:
        """Give a message's block back to its owner, if that still lives, and then free its row."""
        handle = self._ledger.handle(index)
        source = handle[1] & _SOURCE_OF_INCARNATION
        link = self._slots[source & 0xFFFF].link
        if link is not None and source == link.source:
            self.free(link, handle.block)
        if not self._ledger.close_handle(index) and self._dead_sources:
            slot, _, incarnation = layout.unpack_source(source)
            if (slot, incarnation) in self._dead_sources:
                self._dead_sources.remove((slot, incarnation))
                self._announce_gone(slot, incarnation)

    def free(self, link: Link, block: int) -> None:
        """Give one block back."""
        link.freed.push(block)
        if 0 < link.awaited_freed <= link.freed.head:
            self.await_total(link, 0)

    def wait(self, _slot: Slot, link: Link, record: Record) -> None:
        """Note that a module waits until so many of its blocks were ever freed."""
        self.await_total(link, record[1])

    def await_total(self, link: Link, total: int) -> None:
        """Wake a module when so many of its blocks were ever freed: at once if they are."""
        waits = total > link.freed.head
        self.waits += waits - (link.awaited_freed > 0)
        link.awaited_freed = total if waits else 0
        if not waits:
            link.wake()

    def forget(self, link: Link) -> None:
        """Wake a dead module no more."""
        self.waits -= link.awaited_freed > 0

    def bury(self, slot: int, incarnation: int) -> None:
        """Note that an incarnation is dead and has been taken back; its messages may live on."""
        if self._ledger.has_live(slot, incarnation):
            self._dead_sources.add((slot, incarnation))
        else:
            self._announce_gone(slot, incarnation)
        if self._slots[slot].link is None:
            self._words[self._slots[slot].at + layout.PUBLISHER_LINKED] = 0

    def restore(self) -> None:
        """Find out, as a new core, whose messages outlive them, and say again whose do not."""
        connected = {(link.slot, link.incarnation) for link in self._members.links}
        self._dead_sources = self._ledger.sources() - connected
        for slot in self._slots:
            last = self._words[slot.at + layout.PUBLISHER_LAST_INCARNATION]
            for incarnation in range(max(1, last - KNOWN_DEAD), last + 1):
                source = (slot.index, incarnation)
                if source not in connected and source not in self._dead_sources:
                    self._announce_gone(*source)

    def _announce_gone(self, slot: int, incarnation: int) -> None:
        """Say that a dead publisher's last message is gone."""
        self._ledger.forget_source(slot, incarnation)
        self._members.announce_gone((slot, incarnation))
