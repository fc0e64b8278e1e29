"""Who is connected to the core: links to living modules, and what is told to them besides messages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from operator import itemgetter, ne

from robbie_mp.core.link import Link, LinkMemory, Slot
from robbie_mp.errors import RobbieError
from robbie_mp.transport import layout
from robbie_mp.transport.records import Inbound
from robbie_mp.transport.segment import SegmentMismatch, SegmentMissing
from robbie_mp.transport.words import Words

SUPERVISOR_SLOT = 0
_head_of = itemgetter(layout.OUT_HEAD)
NOTICE_LIMIT = 512
"""So many wait at most for a module that takes none, because it is stopped or hangs.

All say which dead publisher's memory to unmap. A module that takes nothing maps nothing, so those beyond the
first few name what it has not mapped. The supervisor's are never left out; no more than it asks for wait.
"""


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
        report: is told what went wrong with whom.
    """

    def __init__(
        self,
        words: Words,
        slots: Sequence[Slot],
        limits: RouterLimits,
        open_memory: Callable[[int, int], LinkMemory],
        report: Callable[[str], None],
    ):
        self._words = words
        self._slots = slots
        self._limits = limits
        self._open_memory = open_memory
        self._report = report
        self.links: tuple[Link, ...] = ()
        self.have_notices = False
        """Some link may have notices for which there was no room yet."""
        self.have_changed = False
        """Somebody new may have written before anybody looked at the ring, and woken nobody by it."""
        self._heads: list[int] = []
        """Of their outbound rings, as seen last."""
        self._ring_words: list[Words] = []

    def connect(self, slot: int, incarnation: int) -> None:
        """Connect with a new incarnation of a module."""
        known = self._slots[slot].link
        if known is not None and known.incarnation == incarnation:
            return  # said again after a restart of the core
        try:
            memory = self._open_memory(slot, incarnation)
        except (SegmentMissing, SegmentMismatch) as error:
            self._accuse(slot, incarnation, str(error))
            return
        known_slot = self._slots[slot]
        link = Link(slot, memory, self._limits.ring_records, known_slot.credit, known_slot.windows)
        known_slot.link = link
        self._set_links((*self.links, link))
        self._words[known_slot.at + layout.PUBLISHER_LINKED] = incarnation
        # In this order: what a new core does not find linked, but knows to have been, it takes for dead.
        self._words[known_slot.at + layout.PUBLISHER_LAST_INCARNATION] = incarnation

    def disconnect(self, link: Link) -> None:
        """Forget a dead incarnation; that it was connected stays written until it has been taken back."""
        self._slots[link.slot].link = None
        link.has_ended = True
        # Of a list: CPython keeps up to 2000 tuples of each length for reuse, and one of a generator, whose
        # length is not known at first, adds to them and never takes any.
        self._set_links(tuple([other for other in self.links if other is not link]))

    def _set_links(self, links: tuple[Link, ...]) -> None:
        self.links = links
        self.have_changed = True
        self._ring_words = [link.out_words for link in links]
        self._heads = [link.outbound.tail for link in links]

    def with_news(self) -> list[Link]:
        """Links whose outbound rings have got records since this was asked last."""
        heads = list(map(_head_of, self._ring_words))  # all that is done for who is silent
        seen = self._heads
        if heads == seen:
            return []
        self._heads = heads
        return list(compress(self.links, map(ne, heads, seen)))

    def fault(self, link: Link, error: RobbieError) -> None:
        """Take no more records of a module that broke the protocol, send it none, and have it killed."""
        link.has_ended = True
        link.ready = False
        self._accuse(link.slot, link.incarnation, str(error))

    def _accuse(self, slot: int, incarnation: int, what: str) -> None:
        self._words[layout.CORE_FAULTS] = self._words[layout.CORE_FAULTS] + 1
        self._report(f"{name_of(slot, incarnation)} is faulted: {what}")
        self.notify(SUPERVISOR_SLOT, (Inbound.FAULTED, slot, incarnation, 0))

    def notify(self, slot: int, notice: tuple[Inbound, int, int, int]) -> None:
        """Tell a module something, as soon as there is room for it in its ring."""
        link = self._slots[slot].link
        if link is not None and (slot == SUPERVISOR_SLOT or len(link.notices) < NOTICE_LIMIT):
            link.notices.append(notice)
            link.send_notices()
            self.have_notices |= bool(link.notices)

    def announce_gone(self, source: tuple[int, int]) -> None:
        """Have a dead publisher's data segments unmapped by everyone, and unlinked by the supervisor.

        Who has never been sent anything has mapped nothing, and may not look at its ring for a long time.
        """
        for link in self.links:
            if link.slot == SUPERVISOR_SLOT or link.inbound.head:
                self.notify(link.slot, (Inbound.SEGMENTS_GONE, *source, 0))


def name_of(slot: int, incarnation: int) -> str:
    """Name an incarnation of a module in a report."""
    return f"module in slot {slot}, incarnation {incarnation},"
