"""What has passed through each channel, as the core counts it; reading it costs the robot nothing."""

from collections.abc import Iterator
from dataclasses import dataclass

from robbie_mp.observe.channel_names import ChannelNames
from robbie_mp.transport.tables import ChannelName, CoreTables, SubscriptionCounts
from robbie_mp.transport.words import Words


@dataclass(frozen=True)
class ChannelCount:
    """Counters of one channel."""

    messages: int = 0
    bytes: int = 0
    last_stamp_ns: int = 0
    """When its newest message was published, monotonic clock; 0: none was."""
    intervals_squared_us2: int = 0
    """Sum of the squares of the times between messages, modulo 2^64."""


class ChannelCounters:
    """The channels' rows in the core segment.

    Args:
        words: the core segment.
    """

    def __init__(self, words: Words):
        self._tables = CoreTables.attach(words)
        self._name = ChannelNames(words)

    def messages(self) -> dict[ChannelName, int]:
        """Return how many messages have passed through each channel there is."""
        return {self._name(row.index): row.messages for row in self._tables.channels()}

    def read(self, type_name: str, version: int, topic: str = "") -> dict[str, ChannelCount]:
        """Return the counts of a type's channels by topic, of one topic or of all ('')."""
        found = {}
        for row in self._tables.channels():
            name = self._name(row.index)
            if name[:2] == (type_name, version) and topic in ("", name.topic):
                found[name.topic] = ChannelCount(
                    row.messages, row.bytes, row.last_stamp_ns, row.intervals_squared_us2
                )
        return found


def messages_missed(words: Words, slot: int) -> int:
    """Return how many messages the module in a slot wanted and will never get, as the core's books say.

    Its queue was full, or they were in the hands of a process of its that died.

    Args:
        words: the core segment.
        slot: of the module.
    """
    return sum(counts.dropped + counts.lost for counts in _counts(words, slot))


def messages_waiting(words: Words, slot: int) -> int:
    """Return how many messages wait for the module in a slot, or are in its hands; arguments as above."""
    return sum(counts.waiting for counts in _counts(words, slot))


def _counts(words: Words, slot: int) -> Iterator[SubscriptionCounts]:
    """Yield the counters of each subscription of the module in a slot."""
    return (row.counts for row in CoreTables.attach(words).subscriptions() if row.slot == slot)
