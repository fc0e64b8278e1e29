"""The router with its hot path in C: messages are published, released and done there in their common form.

The rest is the Python of `router`, on the same books: what follows from the tables is read from them by both,
and what does not (free rows, queues, links) lies where both find it. C handles the records of a module up to
the first that is not common, such as a declaration or a message that does not fit into the tables; it leaves
that one alone before its first store, and Python handles it.
"""

from array import array
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, MutableSequence, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, cast

from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.core import router
from robbie_mp.bus.core.books import Books, Part
from robbie_mp.bus.core.directory import Subscription
from robbie_mp.bus.core.ledger import Handle, Ledger
from robbie_mp.bus.core.members import MODULE_ERRORS, Link, LinkMemory, RouterLimits, Slot
from robbie_mp.bus.core.queues import Queues
from robbie_mp.bus.core.router import Router, SlotLimits
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.ring import NumberRingWriter, RingPlace, RingReader, RingWriter
from robbie_mp.bus.transport.tables import CoreTables
from robbie_mp.bus.transport.words import Words

if TYPE_CHECKING:
    from robbie_mp.bus._hot import native as written_in_c


def make_router(
    native: Native | None,
    tables: CoreTables,
    limits: RouterLimits,
    slots: Sequence[SlotLimits],
    connect: Callable[[int, int], LinkMemory],
    report: Callable[[str], None],
    *,
    lockstep: bool = False,
    charged_ns: Callable[[], int] | None = None,
) -> Router:
    """Make the router of a run; see `Router` for the other arguments.

    Args:
        native: the module written in C; None: all is done in Python, as it always is in lockstep.
        tables: the core's tables.
        limits: bounds of the rings.
        slots: bounds of each slot's queue.
        connect: opens the memory of one incarnation of a module.
        report: called with a line for each fault.
        lockstep: whether one message is handled at a time in the whole run.
        charged_ns: in lockstep, the run's time, if modules are charged for the time of their handlers.
    """
    if native is None or lockstep:
        return Router(tables, limits, slots, connect, report, lockstep=lockstep, charged_ns=charged_ns)
    return NativeRouter(native, tables, limits, slots, connect, report)


class NativeBooks(Books):
    """Makes the parts that Python and C share.

    Args:
        native: the module written in C.
        tables: the core's tables.
        message_bytes: size of the largest valid message.
    """

    def __init__(self, native: Native, tables: CoreTables, message_bytes: int):
        sizes = tables.sizes
        self._native = native
        self.free_handles = native.FreeRows(sizes.handles)
        self.free_references = native.FreeRows(sizes.references)
        self.holders = self.numbers([0] * sizes.handles)
        self.subscriptions: dict[int, Subscription] = {}
        """By their rows."""
        self.in_c: written_in_c.Books = native.Books(
            tables.words,
            tables.handle(0),
            tables.reference(0),
            sizes.subscriptions,
            self.free_handles,
            self.free_references,
            self.holders,
            message_bytes,
        )
        self.in_c.is_wanting = True  # so that the first look before a sleep clears what a dead core wanted

    def of(self, part: type[Part]) -> type[Part]:
        """Return the class to use for a class of the core: some of its attributes lie where C finds them."""
        return cast(type[Part], _with_base(getattr(self._native, part.__name__), cast(Hashable, part)))

    @property
    def is_wanting(self) -> bool:
        """Whether some module may have been asked to post when it releases a message."""
        return self.in_c.is_wanting

    @is_wanting.setter
    def is_wanting(self, value: bool) -> None:
        self.in_c.is_wanting = value

    def enter(self, subscription: Subscription) -> None:
        """Note which subscription has a row of the tables."""
        self.subscriptions[subscription.index] = subscription
        self.in_c.enter(subscription)

    def queue(self) -> OrderedDict[int, int]:
        """Make a queue of references, which may be put back in front, each with a number."""
        return self.in_c.references()

    def references(self) -> dict[int, int]:
        """Make a collection of references, each with a number, in the order in which they are entered."""
        return self.in_c.references()

    def numbers(self, values: Iterable[int]) -> MutableSequence[int]:
        """Make a list of numbers that will keep its length."""
        return array("Q", values)

    def reader(self, place: RingPlace) -> RingReader:
        """Make the reading end of a ring."""
        return cast(RingReader, self._native.RingReader(place))

    def writer(self, place: RingPlace) -> RingWriter:
        """Make the writing end of a ring."""
        return cast(RingWriter, self._native.RingWriter(place))

    def number_writer(self, place: RingPlace) -> NumberRingWriter:
        """Make the writing end of a ring of numbers."""
        return cast(NumberRingWriter, self._native.NumberRingWriter(place))


@cache
def _with_base(base: type, part: Any) -> type:
    made: type = type(part.__name__, (base, part), {"__module__": __name__, "__doc__": part.__doc__})
    return made


class HandleRows:
    """The live messages, read from their rows; what is set is there already."""

    def __init__(self, tables: CoreTables):
        self._words = tables.words
        self._at = tables.handle(0)
        self._count = tables.sizes.handles

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Handle:
        if not 0 <= index < self._count:
            raise IndexError(f"there is no handle {index}")
        words, at = self._words, self._at + index * layout.HANDLE_WORDS
        columns = (words[at + layout.HANDLE_SOURCE + column] for column in range(len(Handle._fields) - 1))
        return Handle(words[at], *columns)

    def __setitem__(self, index: int, handle: Handle) -> None: ...


class ReferenceRows:
    """The live references, read from their rows; what is set is there already.

    Args:
        tables: the core's tables.
        subscriptions: by their rows.
    """

    def __init__(self, tables: CoreTables, subscriptions: Mapping[int, Subscription]):
        self._words = tables.words
        self._at = tables.reference(0)
        self._count = tables.sizes.references
        self._subscriptions = subscriptions

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> tuple[int, int, Subscription] | None:
        if not 0 <= index < self._count:
            raise IndexError(f"there is no reference {index}")
        words, at = self._words, self._at + index * layout.REFERENCE_WORDS
        if not words[at]:
            return None
        subscription = self._subscriptions[words[at + layout.REFERENCE_SUBSCRIPTION]]
        return words[at + layout.REFERENCE_SEQUENCE], words[at + layout.REFERENCE_HANDLE], subscription

    def __setitem__(self, index: int, reference: tuple[int, int, Subscription] | None) -> None: ...


class NativeLedger(Ledger):
    """A ledger whose books C shares.

    Args:
        tables: the core's tables.
        books: have the free rows.
    """

    def __init__(self, tables: CoreTables, books: NativeBooks):
        super().__init__(tables)
        self._free_handles = books.free_handles
        self._free_references = books.free_references
        self._holders = books.holders
        self._handles = cast(MutableSequence[Handle], HandleRows(tables))
        self.handle = HandleRows(tables).__getitem__
        self._references = cast(
            MutableSequence[tuple[int, int, Subscription] | None],
            ReferenceRows(tables, books.subscriptions),
        )


class NativeQueues(Queues):
    """Queues whose figures C writes, and whose modules C wakes.

    Args:
        words: the core segment, for the figures.
        ledger: all references.
        slots: the modules.
        books: know which figures have changed, and which modules are to be woken.
    """

    def __init__(self, words: Words, ledger: Ledger, slots: Sequence[Slot], books: NativeBooks):
        super().__init__(words, ledger, slots)
        self._in_c = books.in_c
        self.outdate, self.note_post = books.in_c.outdate, books.in_c.note_post

    def somebody_waits(self) -> bool:
        """Whether messages wait for a module."""
        return self._in_c.somebody_waits()

    def post(self) -> None:
        """Wake the modules that have been sent records, in that order."""
        self._in_c.post()

    def write_figures(self) -> None:
        """Write the length of the queues, and the number of messages that modules have, for observers."""
        self._in_c.write_figures()


class NativeRouter(Router):
    """A router that has C handle what is common; see `Router` for the other arguments.

    Args:
        native: the module written in C.
    """

    _books: NativeBooks

    def __init__(
        self,
        native: Native,
        tables: CoreTables,
        limits: RouterLimits,
        slots: Sequence[SlotLimits],
        connect: Callable[[int, int], LinkMemory],
        report: Callable[[str], None],
    ):
        self._native = native
        super().__init__(tables, limits, slots, connect, report)
        self._in_c = self._books.in_c
        self._links_in_c: tuple[Link, ...] = ()
        """The links that C knows."""

    def _make_books(self, tables: CoreTables, limits: RouterLimits) -> NativeBooks:
        return NativeBooks(self._native, tables, limits.message_bytes)

    def _make_slots(
        self, tables: CoreTables, limits: RouterLimits, bounds: Sequence[SlotLimits]
    ) -> Sequence[Slot]:
        slots = super()._make_slots(tables, limits, bounds)
        self._books.in_c.set_slots(tuple(slots))
        return slots

    def _make_ledger(self, tables: CoreTables) -> Ledger:
        return NativeLedger(tables, self._books)

    def _make_queues(self) -> Queues:
        return NativeQueues(self._words, self._ledger, self._slots, self._books)

    def run_round(self) -> bool:
        """Give every module with records one turn; return whether any ring has more records."""
        in_c = self._in_c
        if self._members.links is not self._links_in_c:
            self._tell_links()
        link = in_c.serve_round(router.RECORDS_PER_TURN, self._blocks.dead_sources)
        if link is not None:
            self._finish_round(link)
        return in_c.is_unfinished

    def _tell_links(self) -> None:
        self._links_in_c = self._members.links
        self._in_c.set_links(self._links_in_c)

    def _finish_round(self, link: Link | None) -> None:
        """Handle the records of a round that are not common, and have C handle the others.

        Args:
            link: to the module whose record is next; None: the round is over.
        """
        in_c, dead_sources = self._in_c, self._blocks.dead_sources
        while link is not None:
            self._handle_next(link, in_c.left)
            link = in_c.serve_round(router.RECORDS_PER_TURN, dead_sources)

    def work_alone(self, post: Callable[[], None], timeout_s: float) -> bool:
        """Wait for posts and have C handle what is common, until Python must do something.

        Args:
            post: that of the core's own wake-up in C.
            timeout_s: how long to wait for a post; this is also the longest time without a look at signals.

        Returns:
            False, at once, if Python must look after something in each round.
        """
        if self._members.have_notices:
            return False
        if self._members.links is not self._links_in_c:
            self._tell_links()
        timeout_ns, dead_sources = int(timeout_s * 1e9), self._blocks.dead_sources
        self._finish_round(self._in_c.work(post, router.RECORDS_PER_TURN, timeout_ns, dead_sources))
        return True

    def _handle_next(self, link: Link, left: int | None) -> None:
        """Handle the next record of a module, which is not common.

        Args:
            link: to the module.
            left: records that follow in its turn; None: C found its ring corrupt.
        """
        try:
            if left is None:
                link.outbound.waiting()
            else:
                super()._receive(link, 1, left)
                if not left:
                    self._in_c.post()
        except MODULE_ERRORS as error:
            self._members.fault(link, error)

    def before_sleep(self) -> bool:
        """Tell modules when to post on a release; return whether the rings must be looked at again."""
        if self._members.have_changed or self._members.have_notices:
            return super().before_sleep()
        return self._in_c.before_sleep()

    def _receive(self, link: Link, records: int, _more: int = 0) -> None:
        """Handle records that a dead module has left, those that are not common in Python."""
        while records:
            records -= self._in_c.serve(link, records, self._blocks.dead_sources)
            if records:
                records -= 1
                super()._receive(link, 1, records)
        self._in_c.post()
