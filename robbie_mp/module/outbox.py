"""Publishes messages: encodes them into blocks, or lends blocks to be filled, and passes them to the core."""

import logging
import time
import weakref
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic

import numpy as np

from robbie_mp.base.linux.forks import REFUSED, keep_from_forks
from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.blocks import Block, BlockStore, block_bytes
from robbie_mp.bus.transport.endpoint import Endpoint
from robbie_mp.bus.transport.history import Event, OwnHistory
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.bus.transport.words import WORD_MAX, Words
from robbie_mp.messages import Message, lay_out
from robbie_mp.messages.encoded import check_encapsulation, check_type
from robbie_mp.messages.loans import Layout
from robbie_mp.messages.message import check_message, check_message_type
from robbie_mp.messages.well_formed import check_well_formed, find_flaw, ill_formed
from robbie_mp.module.bus import PublishAfterStop
from robbie_mp.module.clock import Clock
from robbie_mp.module.envelope import EncodedMessage, MessageType
from robbie_mp.module.lent_memory import CopiedLoans, freeze_named_arrays
from robbie_mp.module.wiring import UNCHANGED, Wiring, check_topic

MAX_IN_FLIGHT = layout.MAX_OUTSTANDING * 7 // 8
_TARGET_IN_FLIGHT = layout.MAX_OUTSTANDING * 3 // 4
"""With more than the former in flight, the core is asked to drop waiting old messages, down to the latter."""
_MIN_REQUEST_INTERVAL_NS = 10_000_000
"""Least time between two such requests: subscribers hold the messages that the core could not drop."""
_MIN_AGE_TO_DROP_NS = 50_000_000
"""A younger message is not dropped: its subscriber may be about to take it, as in a burst."""
_MAX_WAIT_FOR_ROOM_NS = 25_000_000
"""Longest wait, each of two times, for the core to drop the last message of a latched channel."""
_ROOM_POLL_S = 0.0005
MAX_READY_BLOCK_BYTES = 4096
"""For messages up to this size a block is kept ready; for larger ones, writing costs more than allocating."""


class Outbox:
    """Publishes messages. May be used by any thread of the module.

    Args:
        endpoint: the module's connection to the core.
        blocks: the memory for its messages.
        words: the module's out segment, for the counters.
        clock: stamps the messages (monotonic).
        native: what is written in C, which endpoint and blocks use as well; None: Python does it.
        wiring: the names that the profile gives to the module's topics.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        blocks: BlockStore,
        words: Words,
        clock: Clock,
        native: Native | None = None,
        wiring: Wiring = UNCHANGED,
    ):
        self._endpoint = endpoint
        self._blocks = blocks
        self._words = words
        self._monotonic_ns = clock.monotonic_ns
        self._log = logging.getLogger("robbie.publish")
        self._wiring = wiring
        self._lock = endpoint.lock
        self._declarations: dict[tuple[type[Message], str], int] = {}
        """The number of each channel by type and own topic, without types that are checked."""
        self._channels: dict[ChannelName, int] = {}
        """The same by own name, with types that have no class in this program."""
        self._latched: set[ChannelName] = set()
        """Channels whose newest message the core keeps, by own name."""
        self._held: dict[int, weakref.ref[Any]] = {}
        """The memory of loans whose arrays were still referred to at the end, by block."""
        self._unreferenced: deque[int] = deque()
        """Those whose arrays are gone; filled by finalizers."""
        self._read: set[int] = set()
        """Those that the core has, too: of messages that were not copied, as their arrays are read-only."""
        self.check_class: Callable[[type[Message]], None] = lambda _: None
        """Raises an error if a class may not be published in this run."""
        self.copied_loans = CopiedLoans(self._log)
        self._published_when_asked = -1
        """Number of messages published when `outstanding` was last read."""
        self._paces = False
        """Whether the core knows that this module publishes no faster than it is heard."""
        self._refused = 0
        self._asked_ns = 0
        """When the core was last asked to make room."""
        self.awaits_room = False
        """Whether the module is to be woken when messages have been released."""
        self._awaited: int | None = None
        """The total number of freed blocks at which the module is woken."""
        self._closed = False
        self._history: OwnHistory | None = None
        self._native: Any = None
        """Publishes what is of the common form; None, or its answer None: Python does it."""
        if native is not None and clock.monotonic_ns is time.monotonic_ns:
            self._native = native.Publisher(
                endpoint.native, blocks.blocks, words, self._declarations, self._held
            )
        keep_from_forks(self)

    def record_into(self, history: OwnHistory) -> None:
        """Record from now on what is published."""
        self._history = history
        if self._native is not None:
            self._native.record_into(history.writer)

    def disown(self) -> None:
        """Keep a forked process from publishing: it would write into blocks of its parent."""
        self._lock = REFUSED

    @property
    def outstanding(self) -> int:
        """Number of messages that subscribers still wait for or have."""
        if not self._paces:
            self._pace()
        counted: int | None = None if self._native is None else self._native.outstanding()
        if counted is not None:
            return counted
        with self._lock:
            self.collect_freed()
            published = self._words[layout.OUT_PUBLISHED]
            if self._blocks.taken and published == self._published_when_asked:
                self._endpoint.wake_core()  # otherwise it reads releases only with the next message
            self._published_when_asked = published
            return len(self._blocks.taken)

    def _pace(self) -> None:
        with self._lock:
            if not self._paces:
                self._paces = True
                self._endpoint.pace()

    def wake_after_freed(self, messages: int) -> None:
        """Wake this module when this number of its messages have been released."""
        with self._lock:
            self._paces = True
            self._awaited = self._endpoint.wake_after_freed(messages)
            self.awaits_room = True

    def room_was_made(self) -> bool:
        """Whether the awaited number of messages have been released; True only once."""
        with self._lock:
            self.collect_freed()
            if self._awaited is None or self._endpoint.freed_count < self._awaited:
                return False
            self._awaited = None
            self.awaits_room = False
            return True

    def collect_freed(self) -> None:
        """Put freed blocks back into the free lists."""
        with self._lock:
            freed = self._endpoint.freed()
            if freed:
                self._free(freed)
            while self._unreferenced:
                number = self._unreferenced.popleft()
                del self._held[number]
                if number not in self._read:
                    self._blocks.free([number])

    def advertise(self, message_type: type[Message], topic: str) -> None:
        """Open a channel before the first message."""
        check_message_type(message_type, "advertise")
        with self._lock:
            if (message_type, topic) not in self._declarations:
                self._declare(message_type, topic)

    def publish(self, message: Message | EncodedMessage, topic: str, latched: bool = False) -> bool:
        """Encode a message into a new block, or copy an encoded one, and pass it to the core."""
        if latched and not isinstance(message, EncodedMessage):
            check_message(message, "publish")
            self._latch(_name_of(type(message), topic))
        if self._native is not None:
            done = self._native.publish(message, topic)
            if done is True or self._is_done(done):
                return True
        if isinstance(message, EncodedMessage):  # not first: the common form should not pay for it
            return self._publish_encoded(message, topic, latched)
        with self._lock:
            declaration = self._declarations.get((type(message), topic))
            if declaration is None:
                check_message(message, "publish")
                if message.is_checked:
                    check_well_formed(message)
                declaration = self._declare(type(message), topic)
            size = message.encoded_size()
            block = self._blocks.reuse(size)
            if block is None or len(self._blocks.taken) > layout.MAX_OUTSTANDING:
                block = self._allocate(size, block)
                if block is None:
                    block = self._replace_latched(_name_of(type(message), topic), size)
                if block is None:
                    return self._refuse_for_memory(size, message.type_name, topic)
            try:
                message.encode_into(block.buffer, block.offset)
            except BaseException:
                self._blocks.free([block.number])
                raise
            return self._hand_over(declaration, block, size, message.type_name, topic)

    def _publish_encoded(self, message: EncodedMessage, topic: str, latched: bool) -> bool:
        type_name, version, data = message
        source = data.cast("B")
        check_encapsulation(type_name, source)
        size = len(source)
        name = ChannelName(type_name, version, topic)
        declaration = self._channels.get(name)
        if self._native is not None and declaration is not None and (not latched or name in self._latched):
            done = self._native.publish_encoded(declaration, source)
            if done is True or self._is_done(done):
                return True
        with self._lock:
            if declaration is None:
                check_type(type_name, version)
            if latched:
                self._latch(name)
            declaration = self._advertise(name)
            block = self._allocate(size, self._blocks.reuse(size)) or self._replace_latched(name, size)
            if block is None:
                return self._refuse_for_memory(size, type_name, topic)
            block.buffer[block.offset : block.offset + size] = source
            return self._hand_over(declaration, block, size, type_name, topic)

    def loan(
        self,
        message_type: type[MessageType],
        topic: str,
        fields: Mapping[str, object],
        latched: bool = False,
    ) -> "Loan[MessageType]":
        """Lay a message out in a block, and pass it to the core after the caller has filled it.

        If memory is full, the caller fills a private buffer and the message is counted as refused: a driver
        does not fail because the bus is full.
        """
        return Loan(self, message_type, topic, fields, latched)

    def begin_loan(
        self, message_type: type[MessageType], topic: str, fields: Mapping[str, object], latched: bool
    ) -> tuple[int, Block | None, Layout[MessageType]]:
        """Allocate the block of a loan; return the channel's number, the block and the message's layout."""
        check_message_type(message_type, "loan")
        with self._lock:
            name = _name_of(message_type, topic)
            if latched:
                self._latch(name)
            declaration = self._declarations.get((message_type, topic))
            if declaration is None:
                declaration = self._declare(message_type, topic)
            plan = lay_out(message_type, fields)
            block = self._allocate(plan.size, self._blocks.reuse(plan.size))
            if block is None:
                block = self._replace_latched(name, plan.size)
            return declaration, block, plan

    def end_loan(
        self,
        declaration: int,
        block: Block | None,
        plan: Layout[Any],
        name: tuple[type[Message], str],
        holds: "weakref.ref[Any]",
    ) -> None:
        """Pass a filled block to the core, unless something may still write into it: then pass a copy.

        Args:
            declaration: the channel's number.
            block: the block; None: memory was full.
            plan: the message's layout.
            name: the message's class and topic.
            holds: refers to the lent memory.
        """
        size = plan.size
        if block is not None and self._native is not None and holds() is None:
            done = self._native.hand_over(declaration, block, size)
            if done is True or self._is_done(done):
                return
        message_type, topic = name
        with self._lock:
            if block is None:
                self._refuse_for_memory(size, message_type.type_name, topic)
            elif (held := holds()) is None:
                self._hand_over(declaration, block, size, message_type.type_name, topic)
            elif freeze_named_arrays(held, plan):
                self._read.add(block.number)
                self.give_up(block, holds)
                self._hand_over(declaration, block, size, message_type.type_name, topic)
            else:
                self._hand_over_copy(declaration, block, size, message_type.type_name, topic)
                self.give_up(block, holds)

    def close(self) -> None:
        """Refuse to publish from now on."""
        with self._lock:
            self._closed = True
            if self._native is not None:
                self._native.close()
            self._declarations.clear()
            self._channels.clear()
            self._latched.clear()
            self._blocks.close()

    # -- inside ----------------------------------------------------------------------------------------

    def _is_done(self, size: int | None) -> bool:
        """Prepare the next block after C has published a message of a size; None: it has not."""
        if size is not None:
            with self._lock:
                self._prepare_next(size)
        return size is not None

    def _declare(self, message_type: type[Message], topic: str) -> int:
        check_topic(topic)
        name = _name_of(message_type, topic)
        if message_type.is_latched:
            self._latch(name)
        declaration = self._advertise(name, message_type)
        if not message_type.is_checked:  # so that there is no shorter way for those, neither here nor in C
            self._declarations[message_type, topic] = declaration
        return declaration

    def _advertise(self, name: ChannelName, message_type: type[Message] | None = None) -> int:
        self._check_open(name)
        declaration = self._channels.get(name)
        if declaration is None:
            if message_type is not None:
                self.check_class(message_type)
            actual = name._replace(topic=self._wiring.actual(name.type_name, name.topic))
            declaration = self._channels[name] = self._endpoint.advertise(
                *actual, own_topic=name.topic, is_latched=name in self._latched
            )
        return declaration

    def _latch(self, name: ChannelName) -> None:
        """Have the core keep the newest message of a channel; one that is known already is declared again."""
        if name in self._latched:
            return
        with self._lock:
            self._check_open(name)
            self._latched.add(name)
            if self._channels.pop(name, None) is not None:
                for key in [key for key in self._declarations if _name_of(*key) == name]:
                    del self._declarations[key]

    def _check_open(self, name: ChannelName) -> None:
        if self._closed:
            raise PublishAfterStop(
                f"this module published a {name.type_name} after it was stopped; "
                "publish last messages in teardown(), and end threads there"
            )

    def _allocate(self, size: int, block: Block | None) -> Block | None:
        """Allocate a block if none was ready; refuse if too many blocks are in use."""
        if block is None:
            self.collect_freed()
            block = self._blocks.allocate(size)
            self._words[layout.OUT_SEGMENTS] = self._blocks.segment_count
            self._words[layout.OUT_SEGMENT_BYTES] = self._blocks.total_bytes
        if block is not None and len(self._blocks.taken) > layout.MAX_OUTSTANDING:
            self.collect_freed()
            if len(self._blocks.taken) > layout.MAX_OUTSTANDING:
                self._blocks.free([block.number])
                return None
        return block

    def _replace_latched(self, name: ChannelName, size: int) -> Block | None:
        """Make room for a message of a latched channel, whose last message may be what fills the memory.

        The core drops the last one, so this waits until the core has answered, though not for long.
        """
        if name not in self._latched:
            return None
        blocks = self._blocks
        capacity = block_bytes(size)
        for left_bytes in (blocks.room_bytes - capacity, blocks.taken_bytes - capacity):
            until_ns = time.monotonic_ns() + _MAX_WAIT_FOR_ROOM_NS
            is_asked = False
            while time.monotonic_ns() < until_ns:
                is_asked = is_asked or self._ask_for_room(
                    max(0, min(left_bytes, blocks.enough_bytes)), max(0, left_bytes)
                )
                if (block := self._allocate(size, blocks.reuse(size))) is not None:
                    return block
                time.sleep(_ROOM_POLL_S)
        return None

    def _hand_over(self, declaration: int, block: Block, size: int, type_name: str, topic: str) -> bool:
        if self._endpoint.publish(declaration, block, size, self._monotonic_ns()):
            if self._history is not None:
                data = block.buffer[block.offset : block.offset + size]
                self._history.append(Event.PUBLISHED, 0, declaration, 0, 0, 0, data)
            self._note_published(size)
            return True
        self._free([block.number])
        return self._refuse(type_name, topic)

    def _free(self, numbers: Sequence[int]) -> None:
        """Free blocks that the core no longer has, but later if arrays of a loan still refer to them."""
        if self._held:
            self._read.difference_update(numbers)
            numbers = [number for number in numbers if number not in self._held]
        self._blocks.free(numbers)

    def _note_published(self, size: int) -> None:
        """Count a message, and prepare the next block."""
        words = self._words
        words[layout.OUT_PUBLISHED] = words[layout.OUT_PUBLISHED] + 1 & WORD_MAX
        words[layout.OUT_BLOCKS] = len(self._blocks.taken)
        self._prepare_next(size)

    def _prepare_next(self, size: int) -> None:
        """Prepare the block for the next message of a size while the core routes this message."""
        blocks = self._blocks
        if size > MAX_READY_BLOCK_BYTES:
            self.collect_freed()
        elif not blocks.has_kept(size):
            self.collect_freed()
            blocks.keep_one(size)
        if blocks.taken_bytes + size > blocks.ample_bytes or len(blocks.taken) > MAX_IN_FLIGHT:
            self.collect_freed()
            self._make_room(min(blocks.room_bytes - block_bytes(size), blocks.enough_bytes))

    def _make_room(self, enough_bytes: int, latched_bytes: int = WORD_MAX) -> None:
        """Ask the core to drop old messages that only wait, unless few enough are left.

        Args:
            enough_bytes: size of what may remain in use.
            latched_bytes: if more than this is left, what the core keeps for later subscribers may go too.
        """
        blocks = self._blocks
        if blocks.taken_bytes <= enough_bytes and len(blocks.taken) <= _TARGET_IN_FLIGHT:
            return
        if self._monotonic_ns() - self._asked_ns >= _MIN_REQUEST_INTERVAL_NS:
            self._ask_for_room(max(0, enough_bytes), latched_bytes)

    def _ask_for_room(self, enough_bytes: int, latched_bytes: int) -> bool:
        """Ask the core; return False if it has not handled the last request, or if the ring is full."""
        self._asked_ns = now_ns = self._monotonic_ns()
        before_ns = now_ns - _MIN_AGE_TO_DROP_NS
        return self._endpoint.make_room(_TARGET_IN_FLIGHT, enough_bytes, before_ns, latched_bytes)

    def _refuse_for_memory(self, size: int, type_name: str, topic: str) -> bool:
        """Refuse a message, and ask the core to make room for the next."""
        blocks = self._blocks
        left_bytes = max(0, blocks.taken_bytes - block_bytes(size))
        self._make_room(min(left_bytes, blocks.enough_bytes), left_bytes)
        return self._refuse(type_name, topic)

    def _hand_over_copy(self, declaration: int, block: Block, size: int, type_name: str, topic: str) -> None:
        self.copied_loans.add(type_name)
        copy = self._allocate(size, self._blocks.reuse(size))
        if copy is None:
            self._refuse_for_memory(size, type_name, topic)
            return
        copy.buffer[copy.offset : copy.offset + size] = block.buffer[block.offset : block.offset + size]
        self._hand_over(declaration, copy, size, type_name, topic)

    def give_up(self, block: Block, holds: "weakref.ref[Any]") -> None:
        """Reuse a block as soon as nothing refers to the loaned memory."""
        held = holds()
        if held is None:
            self._read.discard(block.number)
            self._blocks.free([block.number])
            return
        unreferenced, number = self._unreferenced, block.number
        self._held[number] = weakref.ref(held, lambda _: unreferenced.append(number))

    def _refuse(self, type_name: str, topic: str) -> bool:
        self._refused += 1
        if self._history is not None:
            self._history.append(Event.REFUSED)
        self._words[layout.OUT_REFUSED] = self._refused
        self._endpoint.wake_core()  # releases that it has not read yet may make room for the next message
        if self._refused & (self._refused - 1) == 0:  # the 1st, 2nd, 4th, 8th, …: loud, but bounded
            self._log.warning(
                "refused to publish a %s on topic '%s' (%d refused in all): memory or ring is full, "
                "because a subscriber holds messages or the limits in the profile are too small",
                type_name, topic, self._refused,
            )  # fmt: skip
        return False


class Loan(Generic[MessageType]):
    """Lends a block until the end of a `with` block; see `Outbox.loan`. It is used once."""

    __slots__ = (
        "_block",
        "_declaration",
        "_holds",
        "_message",
        "_name",
        "_outbox",
        "_plan",
        "_wanted",
        "_whole",
    )

    def __init__(
        self,
        outbox: Outbox,
        message_type: type[MessageType],
        topic: str,
        fields: Mapping[str, object],
        latched: bool,
    ):
        self._outbox = outbox
        self._name = message_type, topic
        self._wanted = fields, latched

    def __enter__(self) -> MessageType:
        self._declaration, block, plan = self._outbox.begin_loan(*self._name, *self._wanted)
        self._block, self._plan = block, plan
        start = block.buffer[block.offset : block.offset + plan.size] if block else bytearray(plan.size)
        self._whole = np.frombuffer(start, np.uint8)
        self._holds = weakref.ref(self._whole)
        self._message = plan.write(self._whole.data)
        return self._message

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        flaw = find_flaw(self._message) if self._message.is_checked and error is None else None
        self._message.forget_arrays()
        del self._whole
        if error is None and flaw is None:
            self._outbox.end_loan(self._declaration, self._block, self._plan, self._name, self._holds)
        elif self._block is not None:
            self._outbox.give_up(self._block, self._holds)
        if flaw is not None:
            raise ill_formed(self._message.type_name, flaw)


def _name_of(message_type: type[Message], topic: str) -> ChannelName:
    return ChannelName(message_type.type_name, message_type.version, topic)
