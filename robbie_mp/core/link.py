"""The core's ends of the rings to one incarnation of a module, and what outlives that: the module's slot."""

from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robbie_mp.core.directory import Channel
from robbie_mp.errors import RobbieError
from robbie_mp.transport import layout
from robbie_mp.transport.records import Inbound, MessageHandling
from robbie_mp.transport.ring import NumberRingWriter, RingPlace, RingReader, RingWriter
from robbie_mp.transport.tables import DeclarationRow
from robbie_mp.transport.words import Words, new_fence

REPLACEMENT_CHARACTER = "\ufffd"
_HANDLINGS = frozenset(int(handling) for handling in MessageHandling)


class ProtocolViolation(RobbieError, ValueError):
    """A module wrote what no module of ours writes; it is faulted, and restarted by the supervisor."""


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
    """What connects the core with one incarnation of a module."""

    incarnation: int
    out_words: Words
    in_words: Words
    wake: Callable[[], None]
    close: Callable[[], None]


class Link:
    """One incarnation of a module, as the core sees it."""

    def __init__(self, slot: int, memory: LinkMemory, ring_records: int, credit: int, windows: Sequence[int]):
        self.slot = slot
        self.incarnation = memory.incarnation
        self.source = layout.pack_source(slot, 0, memory.incarnation)
        self.out_words = memory.out_words
        self.in_words = memory.in_words
        self.wake = memory.wake
        self.close = memory.close
        out, into = memory.out_words, memory.in_words
        self.outbound = RingReader(
            RingPlace(out, layout.OUT_HEAD, layout.OUT_RING, ring_records, into, layout.IN_OUTBOUND_TAIL)
        )
        capacity = layout.inbound_records(credit)
        tail_at = layout.OUT_INBOUND_TAIL
        self.inbound = RingWriter(RingPlace(into, layout.IN_HEAD, layout.IN_RING, capacity, out, tail_at))
        freed_at = layout.IN_RING + capacity * layout.RECORD_WORDS
        freed_records = layout.FREED_RECORDS
        tail_at = layout.OUT_FREED_TAIL
        self.freed = NumberRingWriter(
            RingPlace(into, layout.IN_FREED_HEAD, freed_at, freed_records, out, tail_at)
        )
        self.channels: dict[int, Channel] = {}
        """By the module's declaration number."""
        self.pushed: dict[int, int] = {}
        """References in its inbound ring or hands, and the number of the record that brought each."""
        self.windows = windows
        """How many bytes of these there may be, by the slot of their publisher."""
        self.in_flight = [0] * len(windows)
        """How many there are."""
        self.pinned: set[int] = set()
        """References it has handled, but holds."""
        self.notices: deque[tuple[Inbound, int, int, int]] = deque()
        self._fence = new_fence()
        self.credit = credit
        """Messages that may be in its inbound ring."""
        self.awaited_freed = 0
        """It wants to be woken when so many of its blocks were ever freed; 0 if it does not wait."""
        self.ready = False
        self.has_ended = False
        """Nothing is taken from it any more: it broke the protocol, or is dead."""
        self._want_release = into[layout.IN_WANT_RELEASE]
        self._first_record = self.outbound.tail

    def is_said_again(self) -> bool:
        """Whether the record being handled may have been handled before, by a core that died over it."""
        return self.outbound.tail == self._first_record

    def want_release(self, wanted: bool) -> bool:
        """Ask the module to post when it releases, or not to; True if it is to do so earlier than it knew.

        As long as it has more to handle, half of what it has is soon enough.
        """
        # Notices behind the last message are not waited for: they are taken when it has been released.
        end = next(reversed(self.pushed.values())) + 1 if self.pushed else self.inbound.head
        want = max(1, end - len(self.pushed) // 2) if wanted else 0
        if want == self._want_release:
            return False
        self.in_words[layout.IN_WANT_RELEASE] = want
        self._want_release = want
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
        """Push what the module is to be told, as far as there is room besides that for its credits."""
        while self.notices and self.inbound.room() > self.credit:
            kind, first, second, third = self.notices.popleft()
            self.inbound.push(kind, first, second, third, 0, 0, 0)
            self.wake()


class Slot:
    """A module through all its incarnations: its waiting messages and its publisher counters."""

    def __init__(self, index: int, at: int, queue_messages: int, queue_bytes: int, credit: int):
        self.index = index
        self.at = at
        self.queue_messages = queue_messages
        self.queue_bytes = queue_bytes
        self.credit = credit
        self.waiting: OrderedDict[int, int] = OrderedDict()
        """References in the order of their sequence, and the bytes of each."""
        self.waiting_bytes = 0
        self.waiting_peak = 0
        self.routed = 0
        self.refused = 0
        self.refused_record: tuple[int, int] | None = None
        """Incarnation, and number of the outbound record, of the message that was refused last."""
        self.windows: list[int] = []
        """Bytes of each publisher that its module may have in its ring and hands; see `Router`."""
        self.link: Link | None = None
