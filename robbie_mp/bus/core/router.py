"""The router: takes the records from the modules' rings in turn, and connects and reclaims modules.

This is plain code over shared words, without system calls, so that tests can stop it after every store.
`process` runs it, `flow` handles messages, and `takeover` takes over from a dead core.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from robbie_mp.bus.core.books import Books
from robbie_mp.bus.core.declarations import Declarations
from robbie_mp.bus.core.directory import Directory
from robbie_mp.bus.core.flow import FreedBlocks, MessageFlow, RoomMaker
from robbie_mp.bus.core.ledger import Ledger
from robbie_mp.bus.core.members import (
    MODULE_ERRORS,
    SUPERVISOR_SLOT,
    Link,
    LinkMemory,
    Members,
    ProtocolViolation,
    RouterLimits,
    Slot,
    name_of,
)
from robbie_mp.bus.core.queues import LockstepQueues, Queues
from robbie_mp.bus.core.takeover import Takeover
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Inbound, Outbound
from robbie_mp.bus.transport.ring import Record
from robbie_mp.bus.transport.tables import CoreTables, Outcome
from robbie_mp.bus.transport.words import WORD_MAX, new_fence

# Looked up once, not for every message: each look-up costs as much as what is done with it.
_PUBLISH, _RELEASE = int(Outbound.PUBLISH), int(Outbound.RELEASE)
RECORDS_PER_TURN = 16
"""Records of one module that are handled before its subscribers are woken and the next one gets its turn."""
IN_FLIGHT_SHARE = 16
"""A subscriber may have messages that it has not handled in at most one part in 16 of a publisher's memory.

The core cannot take such messages back. With this limit, one subscriber that stands still does not make
memory short for the others; only many of them could.
"""
_CONTROL = (Outbound.MODULE_UP, Outbound.MODULE_DOWN, Outbound.MODULE_GONE)


@dataclass(frozen=True)
class SlotLimits:
    """Bounds of one module's queue."""

    queue_messages: int
    queue_bytes: int
    credit: int | None = None
    """Messages that it may have and not have handled yet; None: the default of the run."""
    in_flight_bytes: int = WORD_MAX
    """Most bytes of one publisher that it may have and not have handled yet; one message may be larger."""
    memory_bytes: int = WORD_MAX
    """Memory of its own messages, of which each subscriber may have a share; see IN_FLIGHT_SHARE."""
    is_tool: bool = False
    """Whether it is an attached tool; the rows of its subscriptions are used again after it has left."""
    yields: bool = False
    """Whether it keeps only the newest message of each channel whose publishers pace themselves."""


class Router:
    """Routes handles from publishers to subscribers and gives blocks back.

    Args:
        tables: the core's tables, which this object alone writes.
        limits: bounds of the rings.
        slots: bounds of each slot's queue; slot 0 is the supervisor's, the last one the core's own.
        connect: opens the memory of one incarnation of a module.
        report: called with a line for each fault.
        lockstep: whether one message is handled at a time in the whole run.
        charged_ns: in lockstep, the run's time, if modules are charged for the time of their handlers.
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
        charged_ns: Callable[[], int] | None = None,
    ):
        self._words = tables.words
        self._report = report
        tools = frozenset(index for index, bound in enumerate(slots) if bound.is_tool)
        self._books = self._make_books(tables, limits)
        self._slots = self._make_slots(tables, limits, slots)
        self._directory = Directory(tables, self._books, tools)
        self._ledger = self._make_ledger(tables)
        self._lockstep = lockstep
        self._queues = (
            LockstepQueues(
                self._words, self._ledger, self._slots, tools | {SUPERVISOR_SLOT, len(slots) - 1}, charged_ns
            )
            if lockstep
            else self._make_queues()
        )
        self._members = Members(self._words, self._slots, limits, connect, report, self._books)
        self._blocks = FreedBlocks(self._words, self._ledger, self._slots, self._members)
        self._ledger.give_back = self._blocks.give_back
        declarations = Declarations(
            self._words, self._slots, self._ledger, self._directory, self._queues, report
        )
        self._declarations = declarations
        self._flow = MessageFlow(self._words, limits.message_bytes, self._ledger, self._queues, self._blocks)
        self._on_publish, self._on_release = self._flow.on_publish, self._flow.on_release
        self._fence = new_fence()
        self._unfinished: list[Link] = []
        """Links whose rings have more records than were handled in one turn."""
        self._receivers: dict[Outbound, Callable[[Slot, Link, Record], None]] = {
            Outbound.ADVERTISE: declarations.on_advertise,
            Outbound.SUBSCRIBE: declarations.on_subscribe,
            Outbound.READY: declarations.on_ready,
            Outbound.DONE: self._flow.on_done,
            Outbound.WAIT_FREED: self._blocks.on_wait_freed,
            Outbound.MAKE_ROOM: RoomMaker(self._ledger, self._queues, self._slots).on_make_room,
        }

    # -- the parts that C may take the place of; see `native_router` ----------------------------------------

    def _make_books(self, _tables: CoreTables, _limits: RouterLimits) -> Books:
        return Books()

    def _make_slots(
        self, tables: CoreTables, limits: RouterLimits, bounds: Sequence[SlotLimits]
    ) -> Sequence[Slot]:
        books, new_slot = self._books, self._books.of(Slot)
        made = []
        for index, bound in enumerate(bounds):
            credit = limits.credit if bound.credit is None else bound.credit
            at = tables.publisher(index)
            slot = new_slot(index, at, bound.queue_messages, bound.queue_bytes, credit, books)
            shares = (other.memory_bytes // IN_FLIGHT_SHARE for other in bounds)
            slot.windows = books.numbers(min(bound.in_flight_bytes, share) for share in shares)
            slot.yields = bound.yields
            made.append(slot)
        return made

    def _make_ledger(self, tables: CoreTables) -> Ledger:
        return Ledger(tables)

    def _make_queues(self) -> Queues:
        return Queues(self._words, self._ledger, self._slots)

    # -- modules come and go, as told by the caller ----------------------------------------------------------

    def module_up(self, slot: int, incarnation: int) -> None:
        """Connect with a new incarnation of a module."""
        self._members.connect(slot, incarnation)

    def recover(self) -> None:
        """Take over from a core that died; on fresh tables this does nothing."""
        Takeover(
            self._words,
            self._slots,
            self._ledger,
            self._directory,
            self._queues,
            self._members,
            self._blocks,
            self._flow,
            self._declarations,
        ).run()

    # -- the loop's view -------------------------------------------------------------------------------

    def run_round(self) -> bool:
        """Give every module with records one turn; return whether any ring has more records.

        Rings that begin with a release come last: a subscriber waits for every message, but a publisher
        rarely waits for a release.
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
        """Give a module one turn: handle the first records of its ring, unless the module is faulted."""
        if link.has_ended:
            return
        try:
            waiting = link.outbound.waiting()
            if waiting > RECORDS_PER_TURN:
                self._unfinished.append(link)
                waiting = RECORDS_PER_TURN
            self._receive(link, waiting)
        except MODULE_ERRORS as error:
            self._members.fault(link, error)

    def before_sleep(self) -> bool:
        """Tell modules when to post on a release; return whether the rings must be looked at again.

        A module pushes a release, issues a fence and then reads its word. The core sets the word, issues a
        fence and then reads the ring. So at least one of the two sees the other's store, and no release is
        missed.
        """
        if self._lockstep:
            self._announce_if_settled()
        members, books = self._members, self._books
        look_again, members.have_changed = members.have_changed, False
        releases_awaited = self._lockstep or self._blocks.are_awaited
        somebody_waits = releases_awaited or self._queues.somebody_waits()
        if not (somebody_waits or books.is_wanting or members.have_notices):
            return look_again
        books.is_wanting = members.have_notices = False
        for link in members.links:
            waited_for = self._slots[link.slot].waiting or (releases_awaited and (link.pushed or link.pinned))
            look_again |= link.want_release(bool(waited_for))
            books.is_wanting |= bool(waited_for)
            if link.notices:
                link.send_notices()
                members.have_notices |= bool(link.notices)
        if look_again:
            self._fence()
        return look_again

    def _announce_if_settled(self) -> None:
        """Wake the modules that wait until no message is left to handle."""
        if not self._queues.is_settled():
            return
        words = self._words
        if words[layout.CORE_SETTLED] != words[layout.CORE_LAST_SEQUENCE]:
            words[layout.CORE_SETTLED] = words[layout.CORE_LAST_SEQUENCE]
            self._fence()
        for link in self._members.links:
            if link.out_words[layout.OUT_AWAITS_SETTLED]:
                link.wake()

    def _receive(self, link: Link, records: int, more: int = 0) -> None:
        """Handle the next records of a module.

        Args:
            link: the module.
            records: how many to handle.
            more: how many are to be handled after them, in the same turn.
        """
        outbound, slot = link.outbound, self._slots[link.slot]
        queues = self._queues
        for left in range(records + more - 1, more - 1, -1):
            queues.holds_posts = left != 0
            record = outbound.peek()
            kind = record[0]
            if kind == _PUBLISH:
                self._on_publish(slot, link, record)
            elif kind == _RELEASE:
                self._on_release(slot, link, record)
            elif kind in _CONTROL and link.slot == SUPERVISOR_SLOT:
                self._control(Outbound(kind), record)
            elif kind in self._receivers:
                self._receivers[Outbound(kind)](slot, link, record)
            else:
                raise ProtocolViolation(f"record of unknown kind {kind}")
            outbound.take()
        if queues.to_post and not more:
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
            if record[3]:
                self._declarations.forget_deaths(slot)
            self._blocks.mark_dead(slot, incarnation)
            self._members.notify(SUPERVISOR_SLOT, (Inbound.RECLAIMED, slot, incarnation, 0))
        elif kind == Outbound.MODULE_GONE:
            outcome = Outcome.DROPPED if record[2] else Outcome.LOST
            self._declarations.close_all(slot, outcome)

    def _reclaim(self, link: Link) -> None:
        """Reclaim what a dead module had; messages that it had not begun to handle wait for its successor."""
        slot = self._slots[link.slot]
        try:
            while not link.has_ended and (waiting := link.outbound.waiting()):
                self._receive(link, min(waiting, RECORDS_PER_TURN))
        except MODULE_ERRORS as error:
            self._report(f"{name_of(link.slot, link.incarnation)} died leaving a broken ring: {error}")
        self._queues.post()  # before what wakes the dead module is closed, as it may be among those to post
        self._members.disconnect(link)
        begun = link.out_words[layout.OUT_INBOUND_TAIL]
        pushed = list(link.pushed.items())
        link.pushed.clear()  # a reference that is put back waits
        for reference, record in reversed(pushed):
            if record < begun:
                if record == begun - 1:
                    self._note_death(link, reference)
                self._ledger.finish(reference, Outcome.LOST)
            else:
                self._queues.put_back(slot, reference)
        for reference in link.pinned:
            self._ledger.close_reference(reference)
        link.pinned.clear()
        self._queues.outdate(slot)
        link.close()

    def _note_death(self, link: Link, reference: int) -> None:
        """Note over which message a module died, if it is latched and so would be given again."""
        sequence, handle, subscription = self._ledger.reference(reference)
        latches = self._slots[-1].waiting
        if any(self._ledger.reference(kept)[1] == handle for kept in latches):
            self._directory.note_death(subscription, sequence, link.incarnation)
