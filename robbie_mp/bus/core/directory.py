"""The directory of channels and subscriptions, in the core's memory and in its tables."""

import re
from collections.abc import Callable
from fnmatch import translate

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.core.books import Books
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.layout import MAX_PATTERNS
from robbie_mp.bus.transport.records import ANY_VERSION, MessageHandling
from robbie_mp.bus.transport.tables import (
    ROW_OPEN,
    ChannelName,
    CoreTables,
    SubscriptionRow,
    deadly_key,
    takes_topic,
)
from robbie_mp.bus.transport.words import WORD_BYTES, WORD_MAX

MAX_INTERVAL_US = 10**9
"""Longest interval between two messages that is counted; a module may claim any time."""


class TableFull(RobbieError, OverflowError):
    """One of the core's tables has no free row; the profile's `core` section sets their sizes."""


class Pattern:
    """Shell patterns for the type and the topic of channels.

    A match takes a few microseconds at most, whatever pattern a module has written: names are short, and the
    expressions of `fnmatch` never backtrack over a star.
    """

    __slots__ = ("_topic", "_type")

    def __init__(self, type_name: str, topic: str):
        self._type = re.compile(translate(type_name))
        self._topic = re.compile(translate(topic))

    def matches(self, channel: "Channel") -> bool:
        """Whether the type and topic of a channel match; any version does."""
        return bool(self._type.match(channel.type_name) and self._topic.match(channel.topic))


class Subscription:
    """One module's subscription to a message type, on one topic or on all; it outlives the module's restarts.

    It is closed when the module stops or no longer asks for it, and opened again when the module asks again.

    A subscription may also be by shell patterns for type and topic. If several patterns of a module match a
    channel, the first of them gets its messages, so the module gets each message once.

    Its counts are only in its row of the tables.
    """

    def __init__(
        self,
        index: int,
        at: int,
        slot: int,
        name: ChannelName,
        handling: MessageHandling,
        *,
        is_latch: bool = False,
    ):
        self.index = index
        self.at = at
        self.slot = slot
        self.declaration = 0
        """The module's number for it."""
        self.is_open = True
        self.declared_by = 0
        """The incarnation of the module that declared it last."""
        self.type_name, self.version, self.topic = name
        self.pattern = Pattern(name.type_name, name.topic) if name.version == ANY_VERSION else None
        self.newest_only = handling is MessageHandling.KEEP_ONLY_NEWEST
        self.is_latch = is_latch
        """Whether it is the core's own, to keep the newest message of one channel for later subscribers."""
        self.queued: int | None = None
        """The reference that waits, of a subscription that keeps only the newest."""

    def matches(self, channel: "Channel") -> bool:
        """Whether this subscription gets the messages of a channel."""
        if self.pattern is not None:
            return self.is_open and self.pattern.matches(channel)
        return (
            self.is_open
            and channel.type_name == self.type_name
            and channel.version == self.version
            and (self.topic == channel.topic if self.is_latch else takes_topic(self.topic, channel.topic))
        )


class Channel:
    """A message type with a version on a topic. Its figures are only in its row of the tables."""

    def __init__(self, index: int, at: int, name: ChannelName):
        self.index = index
        self.at = at
        self.type_name, self.version, self.topic = name
        self.figures_at = (at + layout.CHANNEL_MESSAGES) * WORD_BYTES
        """Where four words of its row begin: messages, bytes, last stamp, squares of the intervals."""
        self.subscriptions: tuple[Subscription, ...] = ()
        """Those that get its messages, in this order; always set as a whole."""
        self.paced_reference = self.paced_sequence = 0
        """The last message of a publisher that paces itself that waited in the queue that yields."""

    def count(self, write: Callable[..., None], before: tuple[int, ...], size: int, stamp_ns: int) -> None:
        """Count a message, and note its publication time and the interval since the one before it.

        After a crash of the core, a message routed again may add its interval twice; only statistics use it.

        Args:
            write: writes four words of the tables.
            before: the figures without this message, the four words at `figures_at`.
            size: size of the message in bytes.
            stamp_ns: when it was published.
        """
        messages, total_bytes, last_stamp_ns, squares = before
        if last_stamp_ns:
            # Between stamps in whole µs, so that intervals add up to the time from the first to the last.
            interval_us = stamp_ns // 1000 - last_stamp_ns // 1000
            if not -MAX_INTERVAL_US < interval_us < MAX_INTERVAL_US:
                interval_us = MAX_INTERVAL_US
            squares = squares + interval_us * interval_us & WORD_MAX
        write(self.figures_at, messages + 1, total_bytes + size, stamp_ns, squares)


class Directory:
    """All channels and subscriptions of a run, including those in the tables that a dead core left.

    Args:
        tables: the core's tables.
        books: makes the channels and subscriptions.
        tools: slots of attached tools, whose closed subscriptions are forgotten.
    """

    def __init__(self, tables: CoreTables, books: Books, tools: frozenset[int] = frozenset()):
        self._core_slot = tables.sizes.slots - 1
        self._tables = tables
        self._books = books
        self._new_channel, self._new_subscription = books.of(Channel), books.of(Subscription)
        self._tools = tools
        self._channels: dict[ChannelName, Channel] = {}
        self.subscriptions: list[Subscription] = []
        self._read_subscriptions()
        self._read_channels()

    def _read_subscriptions(self) -> None:
        for row in self._tables.subscriptions():
            at = self._tables.subscription(row.index)
            entry = self._make(row.index, at, row.slot, row.name, row.handling)
            entry.is_open = row.state == ROW_OPEN
            self._enter(entry)

    def _read_channels(self) -> None:
        for row in self._tables.channels():
            self._add_channel(row.index, row.name)

    def by_index(self, index: int) -> Channel:
        """Return the channel in a row of the table."""
        return next(channel for channel in self._channels.values() if channel.index == index)

    def known_channel(self, name: ChannelName) -> Channel | None:
        """Return a channel, None if no module has opened it."""
        return self._channels.get(name)

    def channel(self, name: ChannelName, slot: int) -> Channel:
        """Return a channel; open it for the module in a slot if there is none of that name.

        Raises:
            TableFull: there are as many channels as the profile allows. Tools may only fill three quarters of
                the table: channels are never closed, and a user may give `robbie pub` any topic.
        """
        if found := self._channels.get(name):
            return found
        index = len(self._channels)
        channels = self._tables.sizes.channels
        if index >= (channels * 3 // 4 if slot in self._tools else channels):
            raise TableFull(
                f"no room for channel {name.type_name} on topic '{name.topic}': {index} are in use"
            )
        self._tables.channel_row(index).write(name)
        return self._add_channel(index, name)

    def note_publisher(self, channel: Channel, slot: int) -> None:
        """Note that the module in a slot publishes on a channel; others take the slots of tools."""
        if slot not in self._tools:
            self._tables.channel_row(channel.index).note_publisher(slot)

    def _add_channel(self, index: int, name: ChannelName) -> Channel:
        channel = self._channels[name] = self._new_channel(index, self._tables.channel(index), name)
        for entry in self.subscriptions:
            _connect(channel, entry)
        return channel

    def subscribe(self, slot: int, name: ChannelName, handling: MessageHandling) -> Subscription:
        """Open a subscription for the module in a slot, or continue the one that the module had before.

        Raises:
            TableFull: there are as many subscriptions as the profile allows.
        """
        entry = self.find(slot, name, handling)
        if entry is not None and entry.is_open:
            self._forget_end(entry)
            return entry
        if name.version == ANY_VERSION and len(self._patterns(slot)) == MAX_PATTERNS:
            raise TableFull(f"a module subscribes by at most {MAX_PATTERNS} patterns")
        entry = self._open_row(slot, name, handling) if entry is None else self._reopen(entry)
        for channel in self._channels.values():
            _connect(channel, entry)
        return entry

    def latch(self, channel: Channel, slot: int) -> None:
        """Have the core keep the newest message of a channel, as the module in a slot asks.

        Raises:
            TableFull: there are as many subscriptions as the profile allows. Tools may only fill three
                quarters of the table.
        """
        rows = len(self.subscriptions)
        if slot in self._tools and rows >= self._tables.sizes.subscriptions * 3 // 4:
            raise TableFull(
                f"no room to latch {channel.type_name} on topic '{channel.topic}': {rows} are in use"
            )
        name = ChannelName(channel.type_name, channel.version, channel.topic)
        self.subscribe(self._core_slot, name, MessageHandling.KEEP_ONLY_NEWEST)

    def latches(self, entry: Subscription) -> list[Subscription]:
        """Return the core's own subscriptions that keep a message which a subscription gets."""
        return [
            latch
            for channel in self._channels.values()
            if entry in channel.subscriptions
            for latch in channel.subscriptions
            if latch.is_latch and latch.queued is not None
        ]

    def find(self, slot: int, name: ChannelName, handling: MessageHandling) -> Subscription | None:
        """Return the subscription of a module, open or closed, or the open subscription of a tool."""
        wanted = (*name, handling is MessageHandling.KEEP_ONLY_NEWEST)
        for entry in self.subscriptions:
            if (
                entry.slot == slot
                and (entry.is_open or slot not in self._tools)
                and (entry.type_name, entry.version, entry.topic, entry.newest_only) == wanted
            ):
                return entry
        return None

    def _open_row(self, slot: int, name: ChannelName, handling: MessageHandling) -> Subscription:
        index = self._free_row(name)
        is_reused = index < len(self.subscriptions)
        self._tables.subscription_row(index).write(slot, name, handling, is_reused=is_reused)
        entry = self._make(index, self._tables.subscription(index), slot, name, handling)
        self._enter(entry)
        return entry

    def _make(
        self, index: int, at: int, slot: int, name: ChannelName, handling: MessageHandling
    ) -> Subscription:
        return self._new_subscription(index, at, slot, name, handling, is_latch=slot == self._core_slot)

    def _enter(self, entry: Subscription) -> None:
        self.subscriptions[entry.index : entry.index + 1] = [entry]
        self._books.enter(entry)

    def _patterns(self, slot: int) -> list[Subscription]:
        """Return the open subscriptions of a module that are by patterns."""
        return [
            entry for entry in self.subscriptions if entry.slot == slot and entry.pattern and entry.is_open
        ]

    def alternatives(self, entry: Subscription, channel: Channel) -> list[Subscription]:
        """Return the subscriptions that compete with `entry` for the messages of a channel, and `entry`.

        These are the matching patterns of one module. Another one of them may be the first after a takeover,
        because rows that a tool has left are used again.
        """
        if entry.pattern is None:
            return [entry]
        return [one for one in self._patterns(entry.slot) if one.matches(channel)]

    def _reopen(self, entry: Subscription) -> Subscription:
        """Continue a closed subscription and its counters."""
        self._forget_end(entry)
        self._row(entry).reopen()
        entry.is_open = True
        return entry

    def _forget_end(self, entry: Subscription) -> None:
        """Note that a module is back; also if a core died while it closed the subscription."""
        row = self._row(entry)
        row.forget_end(row.counts.dropped)

    def _row(self, entry: Subscription) -> SubscriptionRow:
        return self._tables.subscription_row(entry.index)

    def _free_row(self, name: ChannelName) -> int:
        """Return the next row, or one that a tool has left and no reference names any more."""
        for entry in self.subscriptions:
            if entry.slot in self._tools and not entry.is_open:
                return entry.index
        index = len(self.subscriptions)
        if index == self._tables.sizes.subscriptions:
            raise TableFull(f"no room for a subscription to {name.type_name}: {index} are in use")
        return index

    def note_death(self, entry: Subscription, sequence: int, incarnation: int) -> None:
        """Note that an incarnation died in the handler of a latched message; may be repeated."""
        self._row(entry).note_death(sequence, incarnation)

    def forget_deaths(self, entry: Subscription) -> None:
        """Forget over which latched messages a module died; may be repeated."""
        self._row(entry).forget_deaths()

    def is_withheld(self, entry: Subscription, sequence: int) -> bool:
        """Whether a subscription no longer gets a latched message, because its module died twice over it."""
        return deadly_key(sequence) in self._row(entry).withheld

    def note_end(self, entry: Subscription) -> None:
        """Note that messages dropped from now on waited for a module that has ended; may be repeated."""
        row = self._row(entry)
        row.note_end(row.counts.dropped)

    def close(self, entry: Subscription) -> None:
        """Route no more messages to a subscription; its counters are kept."""
        self._row(entry).close()
        entry.is_open = False
        for channel in self._channels.values():
            if entry in channel.subscriptions:
                channel.subscriptions = tuple([one for one in channel.subscriptions if one is not entry])
                for other in self._patterns(entry.slot) if entry.pattern else ():
                    _connect(channel, other)


def _connect(channel: Channel, entry: Subscription) -> None:
    """Connect a channel to a subscription that matches it, unless an earlier pattern of the module does.

    Patterns come last: modules that subscribe by type use the messages, those that subscribe by patterns
    record or forward them.
    """
    if entry.matches(channel) and not (
        entry.pattern and any(other.pattern and other.slot == entry.slot for other in channel.subscriptions)
    ):
        place = len(channel.subscriptions)
        while not entry.pattern and place and channel.subscriptions[place - 1].pattern:
            place -= 1
        channel.subscriptions = (*channel.subscriptions[:place], entry, *channel.subscriptions[place:])
