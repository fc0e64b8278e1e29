"""The channels in the core's tables: their names, and the count of messages routed through each.

Reading them costs the robot nothing.
"""

from collections.abc import Iterator

from robbie_mp.bus.transport.tables import (
    ROW_OPEN,
    ChannelCounts,
    ChannelName,
    CoreTables,
    SubscriptionCounts,
)
from robbie_mp.bus.transport.words import Words


class ChannelNames:
    """Reads the row of each channel once: channels are never closed or renamed.

    Args:
        words: the core segment.
    """

    def __init__(self, words: Words):
        self._tables = CoreTables.attach(words)
        self._known: dict[int, ChannelName] = {}

    def __call__(self, channel: int) -> ChannelName:
        """Return the name of a channel; the core opens a channel before it routes any of its messages."""
        known = self._known.get(channel)
        if known is None:
            known = self._known[channel] = self._tables.channel_row(channel).name
        return known


class ChannelCounters:
    """The rows of the channels in the core segment.

    Args:
        words: the core segment.
    """

    def __init__(self, words: Words):
        self._tables = CoreTables.attach(words)
        self._name = ChannelNames(words)

    def messages(self) -> dict[ChannelName, int]:
        """Return how many messages have passed through each channel."""
        return {self._name(row.index): row.counts.messages for row in self._tables.channels()}

    def read(self, type_name: str, version: int, topic: str = "") -> dict[str, ChannelCounts]:
        """Return the counts of a type's channels, by topic; `topic` selects one topic, or all with ''."""
        found = {}
        for row in self._tables.channels():
            name = self._name(row.index)
            if name[:2] == (type_name, version) and topic in ("", name.topic):
                found[name.topic] = row.counts
        return found


def latched_channels(words: Words) -> set[ChannelName]:
    """Return the channels whose newest message the core keeps for later subscribers.

    Args:
        words: the core segment.
    """
    tables = CoreTables.attach(words)
    core_slot = tables.sizes.slots - 1
    return {row.name for row in tables.subscriptions() if row.slot == core_slot and row.state == ROW_OPEN}


def messages_missed(words: Words, slot: int) -> int:
    """Return the core's count of messages that the module in a slot subscribed to and will never get.

    Its queue was full, or a process of the module died while it held them.

    Args:
        words: the core segment.
        slot: the slot of the module.
    """
    return sum(counts.missed for counts in _counts(words, slot))


def messages_waiting(words: Words, slot: int) -> int:
    """Return how many messages wait for the module in a slot, or are held by it; arguments as above."""
    return sum(counts.waiting for counts in _counts(words, slot))


def _counts(words: Words, slot: int) -> Iterator[SubscriptionCounts]:
    """Yield the counters of each subscription of the module in a slot."""
    return (row.counts for row in CoreTables.attach(words).subscriptions() if row.slot == slot)
