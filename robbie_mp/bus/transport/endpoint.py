"""A module's end of the bus: publishes, takes and releases handles, without knowing message types."""

import threading
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.forks import REFUSED, keep_from_forks
from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout, ring
from robbie_mp.bus.transport.blocks import Block
from robbie_mp.bus.transport.records import (
    ANY_VERSION,
    CHANNEL_SHIFT,
    DECLARATION_MASK,
    DECLARATION_SHIFT,
    KIND_MASK,
    Delivery,
    Inbound,
    MessageHandling,
    Notice,
    Outbound,
)
from robbie_mp.bus.transport.ring import RingPlace
from robbie_mp.bus.transport.tables import ChannelName, DeclarationRow
from robbie_mp.bus.transport.words import WORD_MAX, Words, new_fence

# Looking up an enumeration's member costs more than everything else that is done with it for a message.
_PUBLISH, _RELEASE = Outbound.PUBLISH, Outbound.RELEASE
_DELIVER = Inbound.DELIVER
_new_tuple = tuple.__new__  # a named tuple's own constructor takes twice as long


class TooManyDeclarations(RobbieError, OverflowError):
    """A module declares more pairs of type and topic than its segment has rows."""


class NameTooLong(RobbieError, ValueError):
    """A type or topic name does not fit into shared memory."""


class NameNotText(RobbieError, ValueError):
    """A type or topic name is not valid Unicode, so it cannot be written into shared memory.

    Example scenarios:
      - a topic is named after a file whose name is not UTF-8
    """


@dataclass(frozen=True)
class EndpointMemory:
    """The memory that connects one incarnation of a module with the core."""

    slot: int
    incarnation: int
    out_words: Words
    in_words: Words
    wake_core: Callable[[], None]


class Endpoint:
    """One incarnation's connection to the core.

    Any thread may declare and publish; only the module's main thread may do the rest.

    Args:
        memory: the incarnation's segments.
        ring_records: capacity of the outbound ring.
        credit: most messages in the inbound ring.
        native: what is written in C; None: Python does it.
    """

    def __init__(self, memory: EndpointMemory, ring_records: int, credit: int, native: Native | None = None):
        out, into = memory.out_words, memory.in_words
        self._source = layout.pack_source(memory.slot, 0, memory.incarnation)
        self._out = out
        self._in = into
        self.wake_core = memory.wake_core
        """Makes the core look at all rings, which a release alone may not do."""
        self._fence = new_fence()
        lock: Any = threading.RLock() if native is None else native.Lock()
        self.lock: AbstractContextManager[bool] = lock
        """Held while a record is pushed; a publisher may hold it longer."""
        self._declaration_fence = new_fence()
        self._declarations = 0
        self._patterns = 0
        self._is_ready = False
        self._asked_for_room_at = 0
        """Number of the record after the last request for room."""
        self._backlog: deque[tuple[Outbound, int, int, int]] = deque()
        # Publishing leaves this room in the ring for releases, which must not be refused.
        self._reserve = min(2 * credit, ring_records // 2)
        ends: Any = ring if native is None else native
        self._outbound: Any = ends.RingWriter(
            RingPlace(out, layout.OUT_HEAD, layout.OUT_RING, ring_records, into, layout.IN_OUTBOUND_TAIL)
        )
        capacity = layout.inbound_records(credit)
        tail_at = layout.OUT_INBOUND_TAIL
        self._inbound: Any = ends.RingReader(
            RingPlace(into, layout.IN_HEAD, layout.IN_RING, capacity, out, tail_at)
        )
        freed_at = layout.IN_RING + capacity * layout.RECORD_WORDS
        tail_at = layout.OUT_FREED_TAIL
        self._freed: Any = ends.NumberRingReader(
            RingPlace(into, layout.IN_FREED_HEAD, freed_at, layout.FREED_RECORDS, out, tail_at)
        )
        self.native: Any = None
        """The common form in C; what it answers with False or NotImplemented, Python does."""
        if native is not None:
            self.native = native.Endpoint(
                self._outbound, self._inbound, self._freed, into, self._source, self._reserve,
                self._backlog, lock, self.wake_core, Delivery,
            )  # fmt: skip
        keep_from_forks(self)

    def close(self) -> None:
        """Let go of the memory."""
        if self.native is not None:
            for end in (self.native, self._outbound, self._inbound, self._freed):
                end.close()

    def disown(self) -> None:
        """Prevent a forked process from pushing or taking records."""
        if self.native is not None and self._outbound is not REFUSED:
            for end in (self.native, self._outbound, self._inbound, self._freed):
                end.disown()
        self.lock = self._outbound = self._inbound = self._freed = self.wake_core = REFUSED

    # -- declarations ----------------------------------------------------------------------------------

    def advertise(
        self,
        type_name: str,
        version: int,
        topic: str,
        own_topic: str | None = None,
        *,
        is_latched: bool = False,
    ) -> int:
        """Declare a channel; return its number, with which you publish.

        Args:
            type_name: type of the messages.
            version: version of the messages.
            topic: topic of the messages.
            own_topic: as for `subscribe`.
            is_latched: whether the core keeps the channel's newest message for later subscribers.
        """
        handling = MessageHandling.KEEP_ONLY_NEWEST if is_latched else MessageHandling.ALWAYS_DELIVER
        number = self._declare(Outbound.ADVERTISE, type_name, version, topic, handling, own_topic=own_topic)
        self.send(Outbound.ADVERTISE, number)
        return number

    def subscribe(
        self,
        type_name: str,
        version: int,
        topic: str,
        handling: MessageHandling,
        handler: str = "",
        *,
        is_optional: bool = False,
        own_topic: str | None = None,
    ) -> int:
        """Declare a subscription; return its number, which deliveries carry.

        Args:
            type_name: type of the messages.
            version: version of the messages; ANY_VERSION: type and topic are shell patterns.
            topic: topic of the messages; '' for all topics, 'laser/' for all that begin so.
            handling: what to do with messages that come faster than they are handled.
            handler: name of the function that handles them, for observers.
            is_optional: whether the module works without them, for observers.
            own_topic: the topic as the module's code names it, for observers; None: the same.
        """
        if version == ANY_VERSION:
            if self._patterns == layout.MAX_PATTERNS:
                raise TooManyDeclarations(
                    f"cannot subscribe to '{type_name}' on topic '{topic}': a module has at most "
                    f"{self._patterns} patterns; let one pattern replace several"
                )
            self._patterns += 1
        number = self._declare(
            Outbound.SUBSCRIBE, type_name, version, topic, handling, handler, is_optional, own_topic
        )
        self.send(Outbound.SUBSCRIBE, number)
        if self._is_ready:
            self.send(Outbound.READY)  # has the core send what it keeps of latched channels
        return number

    def _declare(
        self,
        kind: Outbound,
        type_name: str,
        version: int,
        topic: str,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
        handler: str = "",
        is_optional: bool = False,
        own_topic: str | None = None,
    ) -> int:
        own = topic if own_topic is None else own_topic
        for text in (type_name, topic, own):
            try:
                size = len(text.encode())
            except UnicodeEncodeError as error:
                raise NameNotText(
                    f"{text!a} cannot name a type or topic: character {error.start} is half of a surrogate "
                    "pair, as Python makes of bytes that are no UTF-8; make the name of other characters"
                ) from error
            if size > layout.NAME_BYTES:
                raise NameTooLong(f"'{text}' has more than {layout.NAME_BYTES} bytes")
        with self.lock:
            number = self._declarations
            if number == layout.DECLARATION_COUNT:
                raise TooManyDeclarations(
                    f"cannot declare {type_name} on topic '{topic}': a module has at most {number} "
                    "pairs of message type and topic"
                )
            name = ChannelName(type_name, version, topic)
            row = DeclarationRow(number, kind, name, handling, handler, own, is_optional)
            row.write(self._out, self._declaration_fence)
            self._declarations += 1
        return number

    # -- outbound --------------------------------------------------------------------------------------

    def send(self, kind: Outbound, first: int = 0, second: int = 0, third: int = 0) -> None:
        """Push a record that must not be refused, and wake the core."""
        with self.lock:
            self._is_ready |= kind is Outbound.READY
            self._backlog.append((kind, first, second, third))
            self._flush()
        self.wake_core()

    def publish(self, declaration: int, block: Block, size: int, stamp_ns: int) -> bool:
        """Publish a filled block; return False if the ring is full, and then the block stays yours."""
        if self.native is not None and self.native.publish(
            declaration, block.segment, block.offset, size, stamp_ns, block.number
        ):
            return True
        with self.lock:
            outbound = self._outbound
            if self._backlog:
                self._flush()
            if self._backlog or outbound.room() <= self._reserve:
                return False  # it must not overtake the backlog, such as the declaration of its channel
            source = self._source | block.segment << 16
            outbound.push(_PUBLISH, declaration, source, block.offset, size, stamp_ns, block.number)
            self.wake_core()
        return True

    def make_room(
        self, messages: int, memory_bytes: int, before_ns: int, latched_bytes: int = WORD_MAX
    ) -> bool:
        """Have the core drop this module's oldest waiting messages until few enough are left.

        This does nothing while the ring is full, or while the core has not handled the last request: a core
        that is behind would only fall further behind.

        Args:
            messages: maximum number of messages to be left.
            memory_bytes: maximum size of their blocks.
            before_ns: only messages with an earlier stamp are dropped.
            latched_bytes: if their blocks are still larger than this, messages that the core keeps for later
                subscribers are dropped as well.

        Returns:
            Whether the core was asked.
        """
        with self.lock:
            outbound = self._outbound
            is_unanswered = self._in[layout.IN_OUTBOUND_TAIL] < self._asked_for_room_at
            if is_unanswered or self._backlog or outbound.room() <= self._reserve:
                return False
            outbound.push(Outbound.MAKE_ROOM, messages, memory_bytes, before_ns, latched_bytes, 0, 0)
            self._asked_for_room_at = outbound.head
        self.wake_core()
        return True

    def done(self, delivery: Delivery) -> None:
        """Tell the core that a message was handled, but its memory is still in use."""
        self._return(Outbound.DONE, delivery)

    def release(self, delivery: Delivery) -> None:
        """Tell the core that a message was handled and its memory is no longer in use."""
        self._return(_RELEASE, delivery)

    def _return(self, kind: Outbound, delivery: Delivery) -> None:
        if self.native is not None and self.native.give_back(kind, delivery.reference, delivery.sequence):
            return
        with self.lock:
            if self._backlog or not self._outbound.room():
                self._backlog.append((kind, delivery.reference, delivery.sequence, 0))
                self._flush()
            else:
                self._outbound.push(kind, delivery.reference, delivery.sequence, 0, 0, 0, 0)
        # If a module waits for released messages, the core sets this word before it sleeps: wake it when this
        # number of records has been taken here. The core then looks at the ring once more, so at least one of
        # the two sees the other's store. 0: do not wake the core.
        self._fence()
        wanted = self._in[layout.IN_WANT_RELEASE]
        if wanted and self._inbound.tail >= wanted:
            self.wake_core()

    def push_backlog(self) -> bool:
        """Push records that did not fit into the ring before; return whether all are there now."""
        if self._backlog:
            with self.lock:
                self._flush()
            self.wake_core()
        return not self._backlog

    def _flush(self) -> None:
        backlog, outbound = self._backlog, self._outbound
        while backlog and outbound.room() > 0:
            kind, first, second, third = backlog.popleft()
            outbound.push(kind, first, second, third, 0, 0, 0)

    # -- inbound ---------------------------------------------------------------------------------------

    def take(self) -> Delivery | Notice | None:
        """Take the next record. A message that was taken is lost if this process dies.

        This also pushes the backlog of records that did not fit into the ring before.
        """
        if self.native is not None:
            taken: Delivery | None = self.native.take()
            if taken is not NotImplemented:
                return taken
        self.push_backlog()
        record = self._inbound.next()
        if record is None:
            return None
        first, reference, sequence, source, offset, size, stamp_ns, _ = record
        if first & KIND_MASK == _DELIVER:
            declaration, channel = first >> DECLARATION_SHIFT & DECLARATION_MASK, first >> CHANNEL_SHIFT
            return _new_tuple(
                Delivery, (declaration, channel, reference, sequence, source, offset, size, stamp_ns)
            )
        return Notice(Inbound(first & KIND_MASK), reference, sequence)

    def freed(self) -> list[int]:
        """Return the numbers of blocks whose messages have no reference left."""
        numbers: list[int] = self._freed.take_all()
        return numbers

    @property
    def freed_count(self) -> int:
        """Blocks that `freed()` has ever returned."""
        count: int = self._freed.tail
        return count

    def wake_after_freed(self, blocks: int) -> int:
        """Ask to be woken when this number of further blocks is freed; return the `freed_count` then."""
        total: int = self._freed.tail + blocks
        self._out[layout.OUT_PACES] = 1  # both words are for a core that takes over
        self._out[layout.OUT_AWAITED_FREED] = total
        self.send(Outbound.WAIT_FREED, total)
        return total

    def pace(self) -> None:
        """Tell the core that this module paces itself; not while it waits to be woken."""
        self._out[layout.OUT_PACES] = 1
        self.send(Outbound.WAIT_FREED, 0)
