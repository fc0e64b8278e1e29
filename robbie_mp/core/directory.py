"""Who offers and who wants what: channels and subscriptions, in memory and in the core's tables."""

import re
from collections.abc import Callable
from fnmatch import translate

from robbie_mp.errors import RobbieError
from robbie_mp.transport import layout
from robbie_mp.transport.layout import NAME_WORDS, PATTERN_COUNT
from robbie_mp.transport.records import ANY_VERSION, MessageHandling
from robbie_mp.transport.tables import CoreTables
from robbie_mp.transport.words import WORD_BYTES, WORD_MAX, read_text, write_text

LONGEST_INTERVAL_US = 10**9
"""Of two messages; a module may claim any time."""
ROW_OPEN = 1
ROW_CLOSED = 2
COUNTS = (
    *range(layout.SUBSCRIPTION_ROUTED, layout.SUBSCRIPTION_LAST_SEQUENCE),
    layout.SUBSCRIPTION_LEFT,
)
_DROPPED_COUNT = layout.SUBSCRIPTION_DROPPED - layout.SUBSCRIPTION_ROUTED


class TableFull(RobbieError, OverflowError):
    """One of the core's tables has no free row; the profile's `core` section sets their sizes."""


class Pattern:
    """Shell patterns for the type and the topic of channels.

    A match takes a few microseconds at most, whatever a module has written into the pattern: names are
    short, and the expressions of `fnmatch` never try one star twice.
    """

    __slots__ = ("_topic", "_type")

    def __init__(self, type_name: str, topic: str):
        self._type = re.compile(translate(type_name))
        self._topic = re.compile(translate(topic))

    def matches(self, channel: "Channel") -> bool:
        """Whether type and topic of a channel are such; the version may be any."""
        return bool(self._type.match(channel.type_name) and self._topic.match(channel.topic))


class Subscription:
    """One module's wish for a message type, on all topics or on one; it outlives the module's restarts.

    It is closed when the module is stopped or wishes it no more, and opened again if the module wishes it
    again.

    Or for every message whose type and topic match patterns. A module that has several patterns gets a
    message once: a channel goes to the first of them that matches.
    """

    __slots__ = (
        "at", "counts", "declaration", "declared_by", "index", "is_open", "newest_only", "pattern", "queued",
        "slot", "topic", "type_name", "version",
    )  # fmt: skip

    def __init__(self, index: int, at: int, slot: int, wish: "Wish"):
        self.index = index
        self.at = at
        self.slot = slot
        self.declaration = wish.declaration
        self.is_open = True
        self.declared_by = 0
        """The incarnation of the module that wished it last."""
        self.type_name = wish.type_name
        self.version = wish.version
        self.topic = wish.topic
        self.pattern = Pattern(wish.type_name, wish.topic) if wish.version == ANY_VERSION else None
        self.newest_only = wish.handling is MessageHandling.KEEP_ONLY_NEWEST
        self.queued: int | None = None
        """The reference that waits, of a subscription that keeps only the newest."""
        self.counts = [0, 0, 0, 0, 0]
        """Routed, delivered, replaced, dropped, lost; the words from SUBSCRIPTION_ROUTED on."""

    def matches(self, channel: "Channel") -> bool:
        """Whether messages of a channel are wanted here."""
        if self.pattern is not None:
            return self.is_open and self.pattern.matches(channel)
        return (
            self.is_open
            and channel.type_name == self.type_name
            and channel.version == self.version
            and self.topic in ("", channel.topic)
        )


class Wish:
    """What a module declared in its out segment."""

    __slots__ = ("declaration", "handling", "topic", "type_name", "version")

    def __init__(self, declaration: int, type_name: str, version: int, topic: str, handling: MessageHandling):
        self.declaration = declaration
        self.type_name = type_name
        self.version = version
        self.topic = topic
        self.handling = handling


class Channel:
    """A message type with a version on a topic."""

    __slots__ = (
        "_figures_at", "at", "bytes", "index", "intervals_squared", "last_stamp_ns", "messages",
        "subscriptions", "topic", "type_name", "version",
    )  # fmt: skip

    def __init__(self, index: int, at: int, type_name: str, version: int, topic: str):
        self.index = index
        self.at = at
        self.type_name = type_name
        self.version = version
        self.topic = topic
        self._figures_at = (at + layout.CHANNEL_MESSAGES) * WORD_BYTES
        self.messages = 0
        self.bytes = 0
        self.last_stamp_ns = 0
        self.intervals_squared = 0
        self.subscriptions: list[Subscription] = []

    def count(self, write: Callable[..., None], size: int, stamp_ns: int) -> None:
        """Count a message, and show when it was published, and how long after the one before it.

        A message routed again after a crash of the core may add its interval twice; nothing rests on it.

        Args:
            write: writes four words of the tables.
            size: of the message in bytes.
            stamp_ns: when it was published.
        """
        self.messages += 1
        self.bytes += size
        if self.last_stamp_ns:
            interval_us = (stamp_ns - self.last_stamp_ns) // 1000
            if not -LONGEST_INTERVAL_US < interval_us < LONGEST_INTERVAL_US:
                interval_us = LONGEST_INTERVAL_US
            self.intervals_squared = self.intervals_squared + interval_us * interval_us & WORD_MAX
        self.last_stamp_ns = stamp_ns
        write(
            self._figures_at,
            self.messages, self.bytes, stamp_ns, self.intervals_squared,
        )  # fmt: skip


class Directory:
    """All channels and subscriptions of a run; those that a dead core left are found again.

    Args:
        tables: the core's tables.
        tools: slots of attached tools, whose closed subscriptions are forgotten.
    """

    def __init__(self, tables: CoreTables, tools: frozenset[int] = frozenset()):
        self._tables = tables
        self._tools = tools
        self._channels: dict[tuple[str, int, str], Channel] = {}
        self.subscriptions: list[Subscription] = []
        self._read_subscriptions()
        self._read_channels()

    def _read_subscriptions(self) -> None:
        words = self._tables.words
        for index in range(self._tables.sizes.subscriptions):
            at = self._tables.subscription(index)
            state = words[at + layout.SUBSCRIPTION_STATE]
            if not state:
                break
            wish = Wish(
                0,
                read_text(words, at + layout.SUBSCRIPTION_TYPE, NAME_WORDS),
                words[at + layout.SUBSCRIPTION_VERSION],
                read_text(words, at + layout.SUBSCRIPTION_TOPIC, NAME_WORDS),
                MessageHandling(words[at + layout.SUBSCRIPTION_HANDLING]),
            )
            entry = Subscription(index, at, words[at + layout.SUBSCRIPTION_SLOT], wish)
            entry.counts = [words[at + layout.SUBSCRIPTION_ROUTED + column] for column in range(5)]
            entry.is_open = state == ROW_OPEN
            self.subscriptions.append(entry)

    def _read_channels(self) -> None:
        words = self._tables.words
        for index in range(self._tables.sizes.channels):
            at = self._tables.channel(index)
            if not words[at + layout.CHANNEL_STATE]:
                break
            type_name = read_text(words, at + layout.CHANNEL_TYPE, NAME_WORDS)
            version = words[at + layout.CHANNEL_VERSION]
            channel = self.channel(
                type_name, version, read_text(words, at + layout.CHANNEL_TOPIC, NAME_WORDS)
            )
            channel.messages = words[at + layout.CHANNEL_MESSAGES]
            channel.bytes = words[at + layout.CHANNEL_BYTES]
            channel.last_stamp_ns = words[at + layout.CHANNEL_LAST_STAMP_NS]
            channel.intervals_squared = words[at + layout.CHANNEL_INTERVALS_SQUARED]

    def by_index(self, index: int) -> Channel:
        """Find a channel by its row."""
        return next(channel for channel in self._channels.values() if channel.index == index)

    def known_channel(self, type_name: str, version: int, topic: str) -> Channel | None:
        """Find a channel if it was opened."""
        return self._channels.get((type_name, version, topic))

    def channel(self, type_name: str, version: int, topic: str, slot: int = 0) -> Channel:
        """Find a channel, or open it for the module in a slot.

        Raises:
            TableFull: there are as many channels as the profile allows. A quarter of them is not for tools:
                channels are never closed, and `robbie pub` may be given any topic.
        """
        key = (type_name, version, topic)
        if found := self._channels.get(key):
            return found
        index = len(self._channels)
        channels = self._tables.sizes.channels
        if index >= (channels * 3 // 4 if slot in self._tools else channels):
            raise TableFull(f"no room for channel {type_name} on topic '{topic}': {index} are in use")
        words, at = self._tables.words, self._tables.channel(index)
        write_text(words, at + layout.CHANNEL_TYPE, NAME_WORDS, type_name)
        write_text(words, at + layout.CHANNEL_TOPIC, NAME_WORDS, topic)
        words[at + layout.CHANNEL_VERSION] = version
        words[at + layout.CHANNEL_STATE] = ROW_OPEN
        channel = self._channels[key] = Channel(index, at, type_name, version, topic)
        for entry in self.subscriptions:
            _connect(channel, entry)
        return channel

    def subscribe(self, slot: int, wish: Wish) -> Subscription:
        """Open a subscription, or go on with the one that the module had before.

        Raises:
            TableFull: there are as many subscriptions as the profile allows.
        """
        entry = self.find(slot, wish)
        if entry is not None and entry.is_open:
            self._forget_end(entry)
            return entry
        if wish.version == ANY_VERSION and len(self._patterns(slot)) == PATTERN_COUNT:
            raise TableFull(f"a module subscribes by at most {PATTERN_COUNT} patterns")
        entry = self._open_row(slot, wish) if entry is None else self._reopen(entry)
        for channel in self._channels.values():
            _connect(channel, entry)
        return entry

    def find(self, slot: int, wish: Wish) -> Subscription | None:
        """Return a module's subscription of that kind, open or closed; of a tool's, one that is open."""
        newest_only = wish.handling is MessageHandling.KEEP_ONLY_NEWEST
        wanted = (wish.type_name, wish.version, wish.topic, newest_only)
        for entry in self.subscriptions:
            if (
                entry.slot == slot
                and (entry.is_open or slot not in self._tools)
                and (entry.type_name, entry.version, entry.topic, entry.newest_only) == wanted
            ):
                return entry
        return None

    def _open_row(self, slot: int, wish: Wish) -> Subscription:
        index = self._free_row(wish)
        words, at = self._tables.words, self._tables.subscription(index)
        write_text(words, at + layout.SUBSCRIPTION_TYPE, NAME_WORDS, wish.type_name)
        write_text(words, at + layout.SUBSCRIPTION_TOPIC, NAME_WORDS, wish.topic)
        words[at + layout.SUBSCRIPTION_SLOT] = slot
        words[at + layout.SUBSCRIPTION_HANDLING] = wish.handling
        words[at + layout.SUBSCRIPTION_VERSION] = wish.version
        if index < len(self.subscriptions):
            for column in COUNTS:
                words[at + column] = 0
        words[at + layout.SUBSCRIPTION_STATE] = ROW_OPEN
        entry = Subscription(index, at, slot, wish)
        self.subscriptions[index : index + 1] = [entry]
        return entry

    def _patterns(self, slot: int) -> list[Subscription]:
        """Return the subscriptions of a module by patterns."""
        return [
            entry for entry in self.subscriptions if entry.slot == slot and entry.pattern and entry.is_open
        ]

    def alternatives(self, entry: Subscription, channel: Channel) -> list[Subscription]:
        """Return the subscriptions of which one gets the messages of a channel, if `entry` is among them.

        They are those of a module by patterns. Which is the first of them may change when a core takes
        over, because rows that a tool has left are used again.
        """
        if entry.pattern is None:
            return [entry]
        return [one for one in self._patterns(entry.slot) if one.matches(channel)]

    def _reopen(self, entry: Subscription) -> Subscription:
        """Go on with a subscription that was closed; its counts go on, too."""
        self._forget_end(entry)
        self._tables.words[entry.at + layout.SUBSCRIPTION_STATE] = ROW_OPEN
        entry.is_open = True
        return entry

    def _forget_end(self, entry: Subscription) -> None:
        """Note that a module has not ended for good; also if a core died while it closed the subscription."""
        words, at = self._tables.words, entry.at + layout.SUBSCRIPTION_LEFT
        if words[at] & 1:
            words[at] = layout.left_waiting(words[at], entry.counts[_DROPPED_COUNT]) << 1

    def _free_row(self, wish: Wish) -> int:
        """Return the next row, or one that a tool has left: no reference leads there any more.

        While it is written anew it stays closed. Its last sequence stays for good: it only ever grows.
        """
        for entry in self.subscriptions:
            if entry.slot in self._tools and not entry.is_open:
                return entry.index
        index = len(self.subscriptions)
        if index == self._tables.sizes.subscriptions:
            raise TableFull(f"no room for a subscription to {wish.type_name}: {index} are in use")
        return index

    def note_end(self, entry: Subscription) -> None:
        """Note that what is dropped from now on waited for a module that has ended; may be done again."""
        words, at = self._tables.words, entry.at + layout.SUBSCRIPTION_LEFT
        if not words[at] & 1:
            words[at] = entry.counts[_DROPPED_COUNT] - (words[at] >> 1) << 1 | 1

    def close(self, entry: Subscription) -> None:
        """Route nothing more to a subscription; its counters stay."""
        self._tables.words[entry.at + layout.SUBSCRIPTION_STATE] = ROW_CLOSED
        entry.is_open = False
        for channel in self._channels.values():
            if entry in channel.subscriptions:
                channel.subscriptions.remove(entry)
                for other in self._patterns(entry.slot) if entry.pattern else ():
                    _connect(channel, other)


def _connect(channel: Channel, entry: Subscription) -> None:
    """Send a channel's messages to a subscription if it wants them and no pattern before it has them.

    Patterns come last: who asks for a type uses it, who asks by patterns records it or sends it on.
    """
    if entry.matches(channel) and not (
        entry.pattern and any(other.pattern and other.slot == entry.slot for other in channel.subscriptions)
    ):
        place = len(channel.subscriptions)
        while not entry.pattern and place and channel.subscriptions[place - 1].pattern:
            place -= 1
        channel.subscriptions.insert(place, entry)
