"""Typed rows of the tables in shared memory: where each row lies, how it is written, and how to read it.

The core's segment holds five tables. Observers read two of them by name: `ChannelRow` and `SubscriptionRow`.
Handles and references belong to `robbie_mp.bus.core.ledger`. A module's out segment holds its declarations,
`DeclarationRow`.

Every row has a word that is written last. A writer issues a fence before it stores that word, and a reader
issues one after it has loaded the word and before it loads the rest of the row.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from enum import IntEnum
from fnmatch import fnmatchcase
from typing import NamedTuple

from typing_extensions import Self

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.layout import NAME_WORDS
from robbie_mp.bus.transport.records import ANY_VERSION, MessageHandling, Outbound
from robbie_mp.bus.transport.shared_folder import SegmentMissing
from robbie_mp.bus.transport.words import Words, new_fence, read_text, write_text

_DIED_TWICE = (1 << layout.DEADLY_BITS) - 1
ROW_OPEN = 1
ROW_CLOSED = 2


class ChannelName(NamedTuple):
    """Message type, version and topic: those of a channel, or those that a subscription asks for."""

    type_name: str
    version: int
    """ANY_VERSION: type and topic are the shell patterns of a subscription."""
    topic: str

    def takes(self, channel: "ChannelName") -> bool:
        """Whether a subscription to this type, version and topic gets the messages of a channel."""
        if self.version == ANY_VERSION:
            return fnmatchcase(channel.type_name, self.type_name) and fnmatchcase(channel.topic, self.topic)
        return self[:2] == channel[:2] and takes_topic(self.topic, channel.topic)


def takes_topic(subscribed: str, topic: str) -> bool:
    """Whether a subscription by type gets a topic: '' gets all, and 'laser/' gets all that begin so."""
    return subscribed in ("", topic) or (subscribed.endswith("/") and topic.startswith(subscribed))


@dataclass(frozen=True)
class ChannelCounts:
    """The counters of a channel, in the order of its row."""

    messages: int = 0
    """Those routed so far."""
    bytes: int = 0
    last_ns: int = 0
    """When the newest message was published, monotonic clock; 0: there was none."""
    intervals_squared: int = 0
    """Sum of the squared times between two messages, of stamps in whole µs, in µs², modulo 2^64."""


class ChannelRow:
    """One row of the core's channels. Each attribute is read from shared memory when you ask for it."""

    __slots__ = ("_at", "_words", "index")

    def __init__(self, words: Words, at: int, index: int):
        self._words = words
        self._at = at
        self.index = index

    def write(self, name: ChannelName) -> None:
        """Open the row for a new channel; only the core may."""
        words, at = self._words, self._at
        write_text(words, at + layout.CHANNEL_TYPE, NAME_WORDS, name.type_name)
        write_text(words, at + layout.CHANNEL_TOPIC, NAME_WORDS, name.topic)
        words[at + layout.CHANNEL_VERSION] = name.version
        new_fence()()
        words[at + layout.CHANNEL_STATE] = ROW_OPEN

    @property
    def state(self) -> int:
        """ROW_OPEN; 0 if there is no such channel."""
        return self._words[self._at + layout.CHANNEL_STATE]

    @property
    def name(self) -> ChannelName:
        """Type, version and topic of its messages."""
        words, at = self._words, self._at
        return ChannelName(
            read_text(words, at + layout.CHANNEL_TYPE, NAME_WORDS),
            words[at + layout.CHANNEL_VERSION],
            read_text(words, at + layout.CHANNEL_TOPIC, NAME_WORDS),
        )

    def note_publisher(self, slot: int) -> None:
        """Note that a slot has advertised the channel; only the core may, as often as it likes."""
        word, bit = divmod(slot, 64)
        if word < layout.CHANNEL_PUBLISHERS_WORDS:
            self._words[self._at + layout.CHANNEL_PUBLISHERS + word] |= 1 << bit

    @property
    def publishers(self) -> list[int]:
        """The slots that have advertised the channel, also those whose modules have ended."""
        at = self._at + layout.CHANNEL_PUBLISHERS
        words = [self._words[at + word] for word in range(layout.CHANNEL_PUBLISHERS_WORDS)]
        return [slot for slot in range(64 * len(words)) if words[slot // 64] >> slot % 64 & 1]

    @property
    def counts(self) -> ChannelCounts:
        """Its counters."""
        words, at = self._words, self._at + layout.CHANNEL_MESSAGES
        return ChannelCounts(words[at], words[at + 1], words[at + 2], words[at + 3])


class Outcome(IntEnum):
    """State of a reference: `state | nth << 8`, if it is the subscription's n-th reference in that state."""

    FREE = 0
    HELD = 1
    DELIVERED = 2
    REPLACED = 3
    DROPPED = 4
    LOST = 5


@dataclass(frozen=True)
class SubscriptionCounts:
    """Messages of one subscription: those routed to it, and what became of them, as in `Outcome`."""

    routed: int
    delivered: int
    replaced: int
    dropped: int
    lost: int

    @property
    def waiting(self) -> int:
        """Messages that wait in a queue, or that the module has and has not handled yet."""
        ended: int = sum(getattr(self, column) for column in COLUMNS[1:])
        return self.routed - ended

    @property
    def missed(self) -> int:
        """Messages that the module will never get, because it was too slow or a process of it died."""
        return self.dropped + self.lost


COLUMNS = tuple(field.name for field in fields(SubscriptionCounts))
"""The counters of a subscription in their order in its row."""


class SubscriptionRow:
    """One row of the core's subscriptions. Each attribute is read from shared memory when you ask for it."""

    __slots__ = ("_at", "_words", "index")

    def __init__(self, words: Words, at: int, index: int):
        self._words = words
        self._at = at
        self.index = index

    def write(self, slot: int, name: ChannelName, handling: MessageHandling, *, is_reused: bool) -> None:
        """Open the row for a subscription of the module in a slot; only the core may.

        A reused row stays closed until this is done. Its last sequence is kept: that may only grow.
        """
        words, at = self._words, self._at
        write_text(words, at + layout.SUBSCRIPTION_TYPE, NAME_WORDS, name.type_name)
        write_text(words, at + layout.SUBSCRIPTION_TOPIC, NAME_WORDS, name.topic)
        words[at + layout.SUBSCRIPTION_SLOT] = slot
        words[at + layout.SUBSCRIPTION_HANDLING] = handling
        words[at + layout.SUBSCRIPTION_VERSION] = name.version
        if is_reused:
            for column in range(layout.SUBSCRIPTION_COUNTERS):
                words[at + layout.SUBSCRIPTION_ROUTED + column] = 0
            words[at + layout.SUBSCRIPTION_LEFT] = 0
            self.forget_deaths()
        new_fence()()
        words[at + layout.SUBSCRIPTION_STATE] = ROW_OPEN

    @property
    def state(self) -> int:
        """ROW_OPEN, or ROW_CLOSED after its module has stopped; 0 if there is no such subscription."""
        return self._words[self._at + layout.SUBSCRIPTION_STATE]

    @property
    def slot(self) -> int:
        """Slot of the module that subscribed."""
        return self._words[self._at + layout.SUBSCRIPTION_SLOT]

    @property
    def name(self) -> ChannelName:
        """Type, version and topic that it asks for."""
        words, at = self._words, self._at
        return ChannelName(
            read_text(words, at + layout.SUBSCRIPTION_TYPE, NAME_WORDS),
            words[at + layout.SUBSCRIPTION_VERSION],
            read_text(words, at + layout.SUBSCRIPTION_TOPIC, NAME_WORDS),
        )

    @property
    def handling(self) -> MessageHandling:
        """The rule for messages that come faster than the module handles them."""
        return MessageHandling(self._words[self._at + layout.SUBSCRIPTION_HANDLING])

    @property
    def counts(self) -> SubscriptionCounts:
        """Its counters; routed first, so that a message on its way seems to be waiting."""
        words, at = self._words, self._at + layout.SUBSCRIPTION_ROUTED
        return SubscriptionCounts(*[words[at + column] for column in range(layout.SUBSCRIPTION_COUNTERS)])

    def left_waiting(self, dropped: int) -> int:
        """Return how many of the dropped messages were waiting when the module stopped.

        Args:
            dropped: `counts.dropped`.
        """
        return left_waiting(self._words[self._at + layout.SUBSCRIPTION_LEFT], dropped)

    def note_end(self, dropped: int) -> None:
        """Count as left waiting what is dropped from now on; may be repeated. Only the core may."""
        words, at = self._words, self._at + layout.SUBSCRIPTION_LEFT
        if not words[at] & 1:
            words[at] = dropped - (words[at] >> 1) << 1 | 1

    def forget_end(self, dropped: int) -> None:
        """Undo `note_end`: the module is back. Only the core may."""
        words, at = self._words, self._at + layout.SUBSCRIPTION_LEFT
        if words[at] & 1:
            words[at] = left_waiting(words[at], dropped) << 1

    def note_death(self, sequence: int, incarnation: int) -> None:
        """Note that an incarnation died in the handler of a latched message; only the core may.

        One word tells both, so a core that takes over may note the same death again. After the death of
        another incarnation over the same message, the word's incarnation is `_DIED_TWICE`. Of more messages
        than there are words, the oldest one is forgotten.
        """
        words, at, noted = self._words, self._at + layout.SUBSCRIPTION_DEADLY, self.deadly_words
        message, first = deadly_key(sequence), incarnation & _DIED_TWICE
        known = next((word for word in noted if word and word >> layout.DEADLY_BITS == message), None)
        if known is None:
            words[at + noted.index(min(noted))] = message << layout.DEADLY_BITS | first
        elif known & _DIED_TWICE != first:
            words[at + noted.index(known)] = known | _DIED_TWICE

    def forget_deaths(self) -> None:
        """Give the module another chance with all latched messages; only the core may."""
        for place, word in enumerate(self.deadly_words):
            if word:
                self._words[self._at + layout.SUBSCRIPTION_DEADLY + place] = 0

    @property
    def withheld(self) -> set[int]:
        """The `deadly_key` of each message over which two incarnations died: its module no longer gets it."""
        return {word >> layout.DEADLY_BITS for word in self.deadly_words if word & _DIED_TWICE == _DIED_TWICE}

    @property
    def deadly_words(self) -> list[int]:
        """A word for each message over which its module died lately, with the incarnation that did."""
        at = self._at + layout.SUBSCRIPTION_DEADLY
        return [self._words[at + place] for place in range(layout.DEADLY_COUNT)]

    def close(self) -> None:
        """Mark the row as closed; only the core may."""
        self._words[self._at + layout.SUBSCRIPTION_STATE] = ROW_CLOSED

    def reopen(self) -> None:
        """Mark a closed row as open again; only the core may."""
        self._words[self._at + layout.SUBSCRIPTION_STATE] = ROW_OPEN


def deadly_key(sequence: int) -> int:
    """Return what a subscription's row keeps of a message's sequence: the low 40 bits."""
    return sequence & (1 << 64 - layout.DEADLY_BITS) - 1


def left_waiting(word: int, dropped: int) -> int:
    """Return how many of the dropped messages did fit into the queue, but waited when their module stopped.

    While a subscription is open, the word holds that number, times two. After its end, the word holds the
    number of messages that did not fit, times two, plus one. So it is written once at each end, and once when
    the module is back.

    Args:
        word: SUBSCRIPTION_LEFT.
        dropped: `SubscriptionCounts.dropped`.
    """
    return max(0, dropped - (word >> 1)) if word & 1 else word >> 1


class DeclarationRow(NamedTuple):
    """A copy of one row of declarations in a module's out segment. The module may have written anything."""

    number: int
    """Index of the row: the module's number for the channel or subscription."""
    kind: int
    """ADVERTISE or SUBSCRIBE."""
    name: ChannelName
    handling: int
    """A MessageHandling, for a subscription."""
    handler: str
    """Name of the function that handles the messages of a subscription."""
    own_topic: str = ""
    """The topic as the module's code names it; the profile may give it another name."""
    is_optional: bool = False
    """Whether the module works without the messages of a subscription."""

    @classmethod
    def read(cls, words: Words, number: int) -> Self:
        """Copy a row of an out segment. You know that it was written, and have issued a fence."""
        at = _declaration_at(number)
        return cls._read(words, number, words[at + layout.DECLARATION_KIND])

    @classmethod
    def _read(cls, words: Words, number: int, kind: int) -> Self:
        at = _declaration_at(number)
        name = ChannelName(
            read_text(words, at + layout.DECLARATION_TYPE, NAME_WORDS),
            words[at + layout.DECLARATION_VERSION],
            read_text(words, at + layout.DECLARATION_TOPIC, NAME_WORDS),
        )
        handler = read_text(words, at + layout.DECLARATION_HANDLER, NAME_WORDS)
        own_topic = read_text(words, at + layout.DECLARATION_OWN_TOPIC, NAME_WORDS)
        is_optional = words[at + layout.DECLARATION_OPTIONAL] == 1
        handling = words[at + layout.DECLARATION_HANDLING]
        return cls(number, kind, name, handling, handler, own_topic, is_optional)

    @property
    def is_latched(self) -> bool:
        """Whether it is a channel whose newest message the core keeps for later subscribers."""
        return self.kind == Outbound.ADVERTISE and self.handling == MessageHandling.KEEP_ONLY_NEWEST

    @classmethod
    def read_all(cls, words: Words, first: int = 0) -> Iterator[Self]:
        """Copy the rows of an out segment that have been written, from the row `first` on."""
        fence = new_fence()
        for number in range(first, layout.DECLARATION_COUNT):
            kind = words[_declaration_at(number) + layout.DECLARATION_KIND]
            if kind not in (Outbound.ADVERTISE, Outbound.SUBSCRIBE):
                return
            fence()
            yield cls._read(words, number, kind)

    def write(self, words: Words, fence: Callable[[], None]) -> None:
        """Write the row; only the module may.

        Args:
            words: its out segment.
            fence: orders the row before its kind: a core that takes over reads the rows without a token.
        """
        at = _declaration_at(self.number)
        write_text(words, at + layout.DECLARATION_TYPE, NAME_WORDS, self.name.type_name)
        write_text(words, at + layout.DECLARATION_TOPIC, NAME_WORDS, self.name.topic)
        write_text(words, at + layout.DECLARATION_HANDLER, NAME_WORDS, self.handler)
        write_text(words, at + layout.DECLARATION_OWN_TOPIC, NAME_WORDS, self.own_topic)
        words[at + layout.DECLARATION_OPTIONAL] = int(self.is_optional)
        words[at + layout.DECLARATION_VERSION] = self.name.version
        words[at + layout.DECLARATION_HANDLING] = self.handling
        fence()
        words[at + layout.DECLARATION_KIND] = self.kind


def _declaration_at(number: int) -> int:
    return layout.OUT_DECLARATIONS + number * layout.DECLARATION_WORDS


@dataclass(frozen=True)
class TableSizes:
    """Number of rows of each of the core's tables."""

    slots: int
    channels: int
    subscriptions: int
    handles: int
    references: int

    @property
    def words(self) -> int:
        """Size of the whole core segment in words."""
        return layout.core_words(self.slots, self.channels, self.subscriptions, self.handles, self.references)


class CoreTables:
    """The core segment as tables.

    Attributes:
        words: the segment.
        sizes: number of rows of each table.
    """

    def __init__(self, words: Words, sizes: TableSizes):
        self.words = words
        self.sizes = sizes
        self._publishers = layout.CORE_TABLES
        self._channels = self._publishers + sizes.slots * layout.PUBLISHER_WORDS
        self._subscriptions = self._channels + sizes.channels * layout.CHANNEL_WORDS
        self._handles = self._subscriptions + sizes.subscriptions * layout.SUBSCRIPTION_WORDS
        self._references = self._handles + sizes.handles * layout.HANDLE_WORDS

    @classmethod
    def create(cls, words: Words, sizes: TableSizes) -> "CoreTables":
        """Write the sizes into a fresh segment, so that `attach` finds the tables."""
        words[layout.CORE_CHANNELS] = sizes.channels
        words[layout.CORE_SUBSCRIPTIONS] = sizes.subscriptions
        words[layout.CORE_HANDLES] = sizes.handles
        words[layout.CORE_REFERENCES] = sizes.references
        new_fence()()  # the number of slots tells others that the rest is there
        words[layout.CORE_SLOTS] = sizes.slots
        return cls(words, sizes)

    @classmethod
    def attach(cls, words: Words) -> "CoreTables":
        """Find the tables of an existing segment.

        Raises:
            SegmentMissing: they are still being made; without their sizes they would seem empty for ever.
        """
        slots = words[layout.CORE_SLOTS]
        if not slots:
            raise SegmentMissing("the tables of the run's core are just being made; try again")
        new_fence()()
        return cls(
            words,
            TableSizes(
                slots,
                words[layout.CORE_CHANNELS],
                words[layout.CORE_SUBSCRIPTIONS],
                words[layout.CORE_HANDLES],
                words[layout.CORE_REFERENCES],
            ),
        )

    def channels(self) -> Iterator[ChannelRow]:
        """Yield the rows of all channels. Channels are never closed or renamed."""
        fence = new_fence()
        for index in range(self.sizes.channels):
            row = self.channel_row(index)
            if row.state != ROW_OPEN:
                return
            fence()
            yield row

    def subscriptions(self) -> Iterator[SubscriptionRow]:
        """Yield the rows of all subscriptions, open and closed."""
        fence = new_fence()
        for index in range(self.sizes.subscriptions):
            row = self.subscription_row(index)
            if not row.state:
                return
            fence()
            yield row

    def channel_row(self, index: int) -> ChannelRow:
        """Return the row of one channel."""
        return ChannelRow(self.words, self.channel(index), index)

    def subscription_row(self, index: int) -> SubscriptionRow:
        """Return the row of one subscription."""
        return SubscriptionRow(self.words, self.subscription(index), index)

    def publisher(self, slot: int) -> int:
        """First word of a publisher's row."""
        return self._publishers + slot * layout.PUBLISHER_WORDS

    def channel(self, index: int) -> int:
        """First word of a channel's row."""
        return self._channels + index * layout.CHANNEL_WORDS

    def subscription(self, index: int) -> int:
        """First word of a subscription's row."""
        return self._subscriptions + index * layout.SUBSCRIPTION_WORDS

    def handle(self, index: int) -> int:
        """First word of a handle's row."""
        return self._handles + index * layout.HANDLE_WORDS

    def reference(self, index: int) -> int:
        """First word of a reference's row."""
        return self._references + index * layout.REFERENCE_WORDS
