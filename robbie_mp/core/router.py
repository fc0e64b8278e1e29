"""The core without its process: whose turn it is, who comes and goes, and taking over from a dead core.

Plain code over shared words, without system calls of its own. What becomes of a message is in `message_flow`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from robbie_mp.core.declarations import Declarations
from robbie_mp.core.directory import Directory, TableFull
from robbie_mp.core.freed_blocks import FreedBlocks
from robbie_mp.core.ledger import Ledger, Outcome
from robbie_mp.core.link import Link, LinkMemory, ProtocolViolation, Slot
from robbie_mp.core.lockstep_queues import LockstepQueues
from robbie_mp.core.members import SUPERVISOR_SLOT, Members, RouterLimits, name_of
from robbie_mp.core.message_flow import MessageFlow
from robbie_mp.core.queues import Queues
from robbie_mp.core.recovery import restore_declarations, restore_references, restore_slot
from robbie_mp.core.room import RoomMaker
from robbie_mp.transport import layout
from robbie_mp.transport.records import Inbound, Outbound
from robbie_mp.transport.ring import Record, RingCorrupt
from robbie_mp.transport.tables import CoreTables
from robbie_mp.transport.words import WORD_MAX, new_fence

# Looked up once, not for every message: each look-up costs as much as what is done with it.
_PUBLISH, _RELEASE = int(Outbound.PUBLISH), int(Outbound.RELEASE)
_AT_ONCE = 16
"""So many records of a module are handled before it is the next one's turn, and its subscribers are woken."""
_IN_FLIGHT_SHARE = 16
"""A subscriber's ring and hands have at most this part of a publisher's memory, for nothing can be taken back
from there: so it takes many that stand still to make memory short for the others."""
_CONTROL = (Outbound.MODULE_UP, Outbound.MODULE_DOWN, Outbound.MODULE_GONE)

BROKEN = (ProtocolViolation, RingCorrupt, TableFull)
"""What a module is faulted for."""


@dataclass(frozen=True)
class SlotLimits:
    """Bounds of one module's queue."""

    queue_messages: int
    queue_bytes: int
    credit: int | None = None
    """Messages that may be in its inbound ring; None: as many as in every module's."""
    in_flight_bytes: int = WORD_MAX
    """What of one publisher's messages may be in its inbound ring and hands; a single one may be larger."""
    memory_bytes: int = WORD_MAX
    """What its own messages may take; no subscriber's ring and hands may have more than a share of it."""
    is_tool: bool = False
    """Nobody looks at its books when it has left: rows of its subscriptions are used again."""


class Router:
    """Routes handles from publishers to subscribers and gives blocks back.

    Args:
        tables: the core's tables, which this object alone writes.
        limits: bounds of the rings.
        slots: bounds of each slot's queue; slot 0 is the supervisor's.
        connect: opens the memory of one incarnation of a module.
        report: is told what went wrong with whom.
        lockstep: whether one message is handled at a time in the whole run.
    """

    def __init__(
        self,
        tables: CoreTables,
        limits: RouterLimits,
        slots: Sequence[SlotLimits],
        connect: Callable[[int, int], LinkMemory],
        report: Callable[[str], None],
        *,
        lockstep: bool = False,
    ):
        self._words = tables.words
        self._report = report
        tools = frozenset(index for index, bound in enumerate(slots) if bound.is_tool)
        self._directory = Directory(tables, tools)
        self._ledger = Ledger(tables)
        self._slots = [
            Slot(
                index,
                tables.publisher(index),
                bound.queue_messages,
                bound.queue_bytes,
                limits.credit if bound.credit is None else bound.credit,
            )
            for index, bound in enumerate(slots)
        ]
        for slot, bound in zip(self._slots, slots, strict=True):
            shares = (other.memory_bytes // _IN_FLIGHT_SHARE for other in slots)
            slot.windows = [min(bound.in_flight_bytes, share) for share in shares]
        self._lockstep = lockstep
        self._queues = (
            LockstepQueues(self._words, self._ledger, self._slots, tools | {SUPERVISOR_SLOT})
            if lockstep
            else Queues(self._words, self._ledger, self._slots)
        )
        self._members = Members(self._words, self._slots, limits, connect, report)
        self._blocks = FreedBlocks(self._words, self._ledger, self._slots, self._members)
        self._ledger.give_back = self._blocks.give_back
        declarations = Declarations(self._words, self._slots, self._ledger, self._directory, self._queues)
        self._declarations = declarations
        self._flow = MessageFlow(
            self._words,
            limits.message_bytes,
            self._ledger,
            self._directory,
            self._queues,
            self._blocks,
        )
        self._publish, self._release = self._flow.publish, self._flow.release
        self._fence = new_fence()
        self._unfinished: list[Link] = []
        """Whose rings have more records than were handled at once."""
        self._wanting = True
        """Some module may have been asked to post when it releases."""
        self._receivers: dict[Outbound, Callable[[Slot, Link, Record], None]] = {
            Outbound.ADVERTISE: declarations.advertise,
            Outbound.SUBSCRIBE: declarations.subscribe,
            Outbound.READY: declarations.ready,
            Outbound.DONE: self._flow.done,
            Outbound.WAIT_FREED: self._blocks.wait,
            Outbound.MAKE_ROOM: RoomMaker(self._ledger, self._queues, self._slots).make_room,
        }

    def module_up(self, slot: int, incarnation: int) -> None:
        """Connect with a new incarnation of a module."""
        self._members.connect(slot, incarnation)

    def recover(self) -> None:
        """Take over from a core that died: rebuild everything from the tables and the rings.

        On fresh tables this does nothing.
        """
        words = self._words
        self._flow.sequence = words[layout.CORE_LAST_SEQUENCE]
        for slot in self._slots:
            restore_slot(slot, words)
            if incarnation := words[slot.at + layout.PUBLISHER_LINKED]:
                self._members.connect(slot.index, incarnation)
        handles = self._ledger.read_handles()
        for link in self._members.links:
            link.ready = words[self._slots[link.slot].at + layout.PUBLISHER_READY] == link.incarnation
            try:
                restore_declarations(link, self._directory)
            except BROKEN as error:
                self._members.fault(link, error)
        restore_references(self._slots, self._ledger, self._directory)
        self._queues.restore()
        self._flow.finish_routing(self._slots, handles)
        entered = self._ledger.entered([slot.routed for slot in self._slots])
        for link in self._members.links:
            try:
                self._flow.finish_publishing(self._slots[link.slot], link, entered)
            except BROKEN as error:
                self._members.fault(link, error)
        for index in handles:
            if self._ledger.row(index, layout.HANDLE_SEQUENCE) and not self._ledger.is_held(index):
                self._blocks.give_back(index)
        self._blocks.restore()
        for slot in self._slots:
            if slot.link is not None:
                if slot.link.ready:
                    self._queues.pump(slot, slot.link)
                slot.link.wake()
            self._queues.outdate(slot)
        self._queues.write_figures()
        for link in self._members.links:
            self._blocks.await_total(link, link.out_words[layout.OUT_AWAITED_FREED])

    # -- the loop's view -------------------------------------------------------------------------------

    def drain(self) -> bool:
        """Handle a few of the records that wait in each ring; say whether any has more.

        A ring that begins with a release comes last: nobody waits for that, as a rule, while somebody waits
        for every message.
        """
        links: Iterable[Link] = self._members.with_news()
        if self._unfinished:
            links = dict.fromkeys((*links, *self._unfinished))
            self._unfinished = []
        releasing = []
        for link in links:
            if not link.has_ended and link.outbound.glance() == _RELEASE:
                releasing.append(link)
            else:
                self._serve(link)
        for link in releasing:
            self._serve(link)
        self._queues.end_round()
        return bool(self._unfinished)

    def _serve(self, link: Link) -> None:
        """Handle the first records that wait in a module's ring, unless it is faulted."""
        if link.has_ended:
            return
        try:
            waiting = link.outbound.waiting()
            if waiting > _AT_ONCE:
                self._unfinished.append(link)
                waiting = _AT_ONCE
            self._receive(link, waiting)
        except BROKEN as error:
            self._members.fault(link, error)

    def before_sleep(self) -> bool:
        """Tell modules when to post on a release; True if the rings must be looked at again.

        A module looks at its word after it has pushed a release, the core at the ring after it has set the
        word, with a fence between on both sides: so one of the two sees the other, and no release is missed.
        """
        if self._lockstep:
            self._say_if_settled()
        members = self._members
        look_again, members.have_changed = members.have_changed, False
        somebody_waits = self._queues.not_empty or self._blocks.waits or self._lockstep
        if not (somebody_waits or self._wanting or members.have_notices):
            return look_again
        self._wanting = members.have_notices = False
        for link in members.links:
            waited_for = self._slots[link.slot].waiting or (
                (self._blocks.waits or self._lockstep) and (link.pushed or link.pinned)
            )
            look_again |= link.want_release(bool(waited_for))
            self._wanting |= bool(waited_for)
            if link.notices:
                link.send_notices()
                members.have_notices |= bool(link.notices)
        if look_again:
            self._fence()
        return look_again

    def _say_if_settled(self) -> None:
        """Wake who waits for it that nothing is left to handle."""
        if not self._queues.is_settled():
            return
        if self._words[layout.CORE_SETTLED] != self._flow.sequence:
            self._words[layout.CORE_SETTLED] = self._flow.sequence
            self._fence()
        for link in self._members.links:
            if link.out_words[layout.OUT_AWAITS_SETTLED]:
                link.wake()

    def _receive(self, link: Link, records: int) -> None:
        """Handle so many records of a module."""
        outbound, slot = link.outbound, self._slots[link.slot]
        queues = self._queues
        for left in range(records - 1, -1, -1):
            queues.holds_posts = left != 0
            record = outbound.peek()
            kind = record[0]
            if kind == _PUBLISH:
                self._publish(slot, link, record)
            elif kind == _RELEASE:
                self._release(slot, link, record)
            elif kind in _CONTROL and link.slot == SUPERVISOR_SLOT:
                self._control(Outbound(kind), record)
            elif kind in self._receivers:
                self._receivers[Outbound(kind)](slot, link, record)
            else:
                raise ProtocolViolation(f"record of unknown kind {kind}")
            outbound.take()
        if queues.to_post:
            queues.post()

    # -- modules come and go -----------------------------------------------------------------------------

    def _control(self, kind: Outbound, record: Record) -> None:
        slot, incarnation = record[1], record[2]
        link = self._slots[slot].link
        if kind == Outbound.MODULE_UP:
            self._members.connect(slot, incarnation)
        elif kind == Outbound.MODULE_DOWN:
            if link is not None and link.incarnation == incarnation:
                self._reclaim(link)
            self._blocks.bury(slot, incarnation)
            self._members.notify(SUPERVISOR_SLOT, (Inbound.RECLAIMED, slot, incarnation, 0))
        elif kind == Outbound.MODULE_GONE:
            outcome = Outcome.DROPPED if record[2] else Outcome.LOST
            self._declarations.close_all(slot, outcome)

    def _reclaim(self, link: Link) -> None:
        """Take back what a dead module held; what it had not begun to handle waits for its successor."""
        slot = self._slots[link.slot]
        try:
            while not link.has_ended and (waiting := link.outbound.waiting()):
                self._receive(link, min(waiting, _AT_ONCE))
        except BROKEN as error:
            self._report(f"{name_of(link.slot, link.incarnation)} died leaving a broken ring: {error}")
        self._queues.post()  # what was sent to it in this turn, too: soon its semaphore will be closed
        self._members.disconnect(link)
        self._blocks.forget(link)
        begun = link.out_words[layout.OUT_INBOUND_TAIL]
        for reference, record in reversed(list(link.pushed.items())):
            if record < begun:
                self._ledger.finish(reference, Outcome.LOST)
            else:
                self._queues.put_back(slot, reference)
        for reference in link.pinned:
            self._ledger.close_reference(reference)
        self._queues.outdate(slot)
        link.close()
