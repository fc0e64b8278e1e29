"""The modules that the core is connected with: their slots, and the core's ends of their rings."""

from collections import deque
from collections.abc import Callable, MutableSequence, Sequence
from dataclasses import dataclass
from itertools import compress
from operator import itemgetter, ne

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.core.books import Books
from robbie_mp.bus.core.directory import Channel, TableFull
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Inbound, MessageHandling
from robbie_mp.bus.transport.ring import RingCorrupt, RingPlace
from robbie_mp.bus.transport.segment import SegmentMismatch, SegmentMissing
from robbie_mp.bus.transport.tables import DeclarationRow
from robbie_mp.bus.transport.words import Words, new_fence

SUPERVISOR_SLOT = 0
_head_of = itemgetter(layout.OUT_HEAD)
MAX_NOTICES = 512
"""Most notices that wait for a module that takes none, because it is stopped or hangs.

Every notice names a dead publisher whose memory the module is to unmap. A module that takes no messages maps
no memory either, so notices beyond these name memory that it has not mapped. The supervisor gets every
notice; it asks for no more than that.
"""
REPLACEMENT_CHARACTER = "\ufffd"
_HANDLINGS = frozenset(int(handling) for handling in MessageHandling)


class ProtocolViolation(RobbieError, ValueError):
    """A module wrote a record or declaration that breaks the protocol; the supervisor restarts it."""


MODULE_ERRORS = (ProtocolViolation, RingCorrupt, TableFull)
"""Errors for which a module is faulted."""


def checked(row: DeclarationRow) -> DeclarationRow:
    """Return a declaration if it is valid.

    Raises:
        ProtocolViolation: it is not.
    """
    type_name, _, topic = row.name
    # A text that is not UTF-8 would read differently when a new core finds it in the tables.
    if not type_name or row.handling not in _HANDLINGS or REPLACEMENT_CHARACTER in type_name + topic:
        raise ProtocolViolation(
            f"declaration {row.number} has type '{type_name}', topic '{topic}' and handling {row.handling}"
        )
    return row


@dataclass(frozen=True)
class LinkMemory:
    """The core's connection with one incarnation of a module."""

    incarnation: int
    out_words: Words
    in_words: Words
    wake: Callable[[], None]
    close: Callable[[], None]


class Link:
    """One incarnation of a module, as the core sees it."""

    def __init__(
        self,
        slot: int,
        memory: LinkMemory,
        ring_records: int,
        credit: int,
        windows: MutableSequence[int],
        books: Books,
    ):
        self.slot = slot
        self.incarnation = memory.incarnation
        self.source = layout.pack_source(slot, 0, memory.incarnation)
        self.out_words = memory.out_words
        self.in_words = memory.in_words
        self.wake = memory.wake
        self._unmap = memory.close
        out, into = memory.out_words, memory.in_words
        self.outbound = books.reader(
            RingPlace(out, layout.OUT_HEAD, layout.OUT_RING, ring_records, into, layout.IN_OUTBOUND_TAIL)
        )
        capacity = layout.inbound_records(credit)
        tail_at = layout.OUT_INBOUND_TAIL
        self.inbound = books.writer(RingPlace(into, layout.IN_HEAD, layout.IN_RING, capacity, out, tail_at))
        freed_at = layout.IN_RING + capacity * layout.RECORD_WORDS
        freed_records = layout.FREED_RECORDS
        tail_at = layout.OUT_FREED_TAIL
        self.freed = books.number_writer(
            RingPlace(into, layout.IN_FREED_HEAD, freed_at, freed_records, out, tail_at)
        )
        self.channels: dict[int, Channel] = {}
        """By the module's declaration number; always set as a whole."""
        self.pushed = books.references()
        """References that it has been sent and has not handled yet, and the record that brought each."""
        self.windows = windows
        """Most bytes of these, by the slot of their publisher."""
        self.in_flight = books.numbers([0] * len(windows))
        """Bytes of these now, by the slot of their publisher."""
        self.pinned = books.references()
        """References that it has handled, but whose memory it still uses; the values mean nothing."""
        self.notices: deque[tuple[Inbound, int, int, int]] = deque()
        self._fence = new_fence()
        self.credit = credit
        """Messages that may be in its inbound ring."""
        self.awaited_freed = 0
        """Wake it when this total of its blocks has been freed; 0 if it does not wait."""
        self.paces = out[layout.OUT_PACES] != 0
        """Whether it paces itself: it has waited for its blocks, or counted them."""
        self.ready = False
        self.has_ended = False
        """It broke the protocol or is dead, so no more of its records are handled."""
        self.wanted_release = into[layout.IN_WANT_RELEASE]
        """The value of the word with which the core asks the module to post on a release."""
        self._first_record = self.outbound.tail

    def close(self) -> None:
        """Unmap its memory."""
        for end in (self.outbound, self.inbound, self.freed):
            end.close()
        self._unmap()

    def is_repeated(self) -> bool:
        """Whether the record being handled may have been handled before, by a core that died over it."""
        return self.outbound.tail == self._first_record

    def want_release(self, wanted: bool) -> bool:
        """Ask the module to post when it releases a message, or not to.

        It need not post before it has handled half of its messages.

        Returns:
            Whether the module may have missed the request, so that its ring must be looked at again.
        """
        # Notices behind the last message do not count: the module takes them after it has released it.
        end = next(reversed(self.pushed.values())) + 1 if self.pushed else self.inbound.head
        want = max(1, end - len(self.pushed) // 2) if wanted else 0
        if want == self.wanted_release:
            return False
        self.in_words[layout.IN_WANT_RELEASE] = want
        self.wanted_release = want
        return wanted

    def declaration(self, number: int) -> DeclarationRow:
        """Read a declaration from the module's out segment.

        Raises:
            ProtocolViolation: no such declaration is possible.
        """
        if number >= layout.DECLARATION_COUNT:
            raise ProtocolViolation(f"declaration {number} is out of range")
        self._fence()
        return checked(DeclarationRow.read(self.out_words, number))

    def send_notices(self) -> None:
        """Push notices while the ring has more room than the module's credit needs."""
        while self.notices and self.inbound.room() > self.credit:
            kind, first, second, third = self.notices.popleft()
            self.inbound.push(kind, first, second, third, 0, 0, 0)
            self.wake()


class Slot:
    """A module through all its incarnations, and its waiting messages. Its counters are in the tables."""

    def __init__(self, index: int, at: int, queue_messages: int, queue_bytes: int, credit: int, books: Books):
        self.index = index
        self.at = at
        self.queue_messages = queue_messages
        self.queue_bytes = queue_bytes
        self.credit = credit
        self.waiting = books.queue()
        """References in the order of their sequence, each with the size of its message in bytes."""
        self.waiting_bytes = 0
        self.yields = False
        """Whether publishers that pace themselves do not wait for it. At most one module yields in a run."""
        self.windows: MutableSequence[int] = []
        """Most bytes of each publisher that the module may have and not have handled yet; see `Router`."""
        self.link: Link | None = None


@dataclass(frozen=True)
class RouterLimits:
    """Bounds of the rings and of what a module may send."""

    ring_records: int
    credit: int
    message_bytes: int


class Members:
    """The modules that are connected.

    Args:
        words: the core segment.
        slots: every module of the run; slot 0 is the supervisor's.
        limits: bounds of the rings.
        open_memory: maps the memory of one incarnation of a module.
        report: called with a line for each fault.
        books: makes the links.
    """

    def __init__(
        self,
        words: Words,
        slots: Sequence[Slot],
        limits: RouterLimits,
        open_memory: Callable[[int, int], LinkMemory],
        report: Callable[[str], None],
        books: Books,
    ):
        self._words = words
        self._slots = slots
        self._limits = limits
        self._books = books
        self._new_link = books.of(Link)
        self._open_memory = open_memory
        self._report = report
        self.links: tuple[Link, ...] = ()
        self.have_notices = False
        """Some link may have notices for which there was no room yet."""
        self.have_changed = False
        """A new module may have written, and posted, before the core looked at its ring."""
        self._heads: list[int] = []
        """Heads of their outbound rings, as seen last."""
        self._ring_words: list[Words] = []

    def connect(self, slot: int, incarnation: int) -> None:
        """Connect with a new incarnation of a module."""
        known = self._slots[slot].link
        if known is not None and known.incarnation == incarnation:
            return  # repeated after a restart of the core
        try:
            memory = self._open_memory(slot, incarnation)
        except (SegmentMissing, SegmentMismatch) as error:
            self._accuse(slot, incarnation, str(error))
            return
        known_slot = self._slots[slot]
        link = self._new_link(
            slot, memory, self._limits.ring_records, known_slot.credit, known_slot.windows, self._books
        )
        known_slot.link = link
        self._set_links((*self.links, link))
        self._words[known_slot.at + layout.PUBLISHER_LINKED] = incarnation
        # In this order: an incarnation that a new core knows, but does not find linked, is dead to it.
        self._words[known_slot.at + layout.PUBLISHER_LAST_INCARNATION] = incarnation

    def disconnect(self, link: Link) -> None:
        """Forget a dead incarnation. The tables show it as linked until it has been reclaimed."""
        self._slots[link.slot].link = None
        link.has_ended = True
        # From a list: CPython keeps up to 2000 tuples of each length for reuse. A tuple made from a generator
        # adds to them and never takes one, because its length is not known at first.
        self._set_links(tuple([other for other in self.links if other is not link]))

    def _set_links(self, links: tuple[Link, ...]) -> None:
        self.links = links
        self.have_changed = True
        self._ring_words = [link.out_words for link in links]
        self._heads = [link.outbound.tail for link in links]

    def with_news(self) -> list[Link]:
        """Return the links whose outbound rings have new records since the last call."""
        heads = list(map(_head_of, self._ring_words))  # the only cost of a silent module
        seen = self._heads
        if heads == seen:
            return []
        self._heads = heads
        return list(compress(self.links, map(ne, heads, seen)))

    def fault(self, link: Link, error: RobbieError) -> None:
        """Stop handling and sending records of a module that broke the protocol, and have it killed."""
        link.has_ended = True
        link.ready = False
        self._accuse(link.slot, link.incarnation, str(error))

    def _accuse(self, slot: int, incarnation: int, what: str) -> None:
        self._words[layout.CORE_FAULTS] = self._words[layout.CORE_FAULTS] + 1
        self._report(f"{name_of(slot, incarnation)} is faulted: {what}")
        self.notify(SUPERVISOR_SLOT, (Inbound.FAULTED, slot, incarnation, 0))

    def notify(self, slot: int, notice: tuple[Inbound, int, int, int]) -> None:
        """Send a notice to a module as soon as its ring has room."""
        link = self._slots[slot].link
        if link is not None and (slot == SUPERVISOR_SLOT or len(link.notices) < MAX_NOTICES):
            link.notices.append(notice)
            link.send_notices()
            self.have_notices |= bool(link.notices)

    def announce_gone(self, source: tuple[int, int]) -> None:
        """Have all modules unmap a dead publisher's data segments, and the supervisor unlink them.

        A module that was never sent a message has mapped none, and may not read its ring for a long time.
        """
        for link in self.links:
            if link.slot == SUPERVISOR_SLOT or link.inbound.head:
                self.notify(link.slot, (Inbound.SEGMENTS_GONE, *source, 0))


def name_of(slot: int, incarnation: int) -> str:
    """Name an incarnation of a module in a report."""
    return f"module in slot {slot}, incarnation {incarnation},"
