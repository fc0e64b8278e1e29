"""What has passed through each channel, as the core counts it; reading it costs the robot nothing."""

from collections.abc import Iterator
from dataclasses import dataclass

from robbie_mp.core.directory import ROW_OPEN
from robbie_mp.observe.channel_names import ChannelNames
from robbie_mp.transport import layout
from robbie_mp.transport.endpoint import ChannelName
from robbie_mp.transport.tables import CoreTables
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
        self._words = words
        self._tables = CoreTables.attach(words)
        self._name = ChannelNames(words)

    def messages(self) -> dict[ChannelName, int]:
        """Return how many messages have passed through each channel there is."""
        return {
            self._name(index): self._words[at + layout.CHANNEL_MESSAGES] for index, at in self._channels()
        }

    def _channels(self) -> Iterator[tuple[int, int]]:
        for index in range(self._tables.sizes.channels):
            at = self._tables.channel(index)
            if self._words[at + layout.CHANNEL_STATE] != ROW_OPEN:
                break
            yield index, at

    def read(self, type_name: str, version: int, topic: str = "") -> dict[str, ChannelCount]:
        """Return the counts of a type's channels by topic, of one topic or of all ('')."""
        words = self._words
        found = {}
        for index, at in self._channels():
            name = self._name(index)
            if name[:2] == (type_name, version) and topic in ("", name.topic):
                found[name.topic] = ChannelCount(
                    words[at + layout.CHANNEL_MESSAGES],
                    words[at + layout.CHANNEL_BYTES],
                    words[at + layout.CHANNEL_LAST_STAMP_NS],
                    words[at + layout.CHANNEL_INTERVALS_SQUARED],
                )
        return found


def messages_missed(words: Words, slot: int) -> int:
    """Return how many messages the module in a slot wanted and will never get, as the core's books say.

    Its queue was full, or they were in the hands of a process of its that died.

    Args:
        words: the core segment.
        slot: of the module.
    """
    return sum(dropped + lost for _, _, _, dropped, lost in _books(words, slot))


def messages_waiting(words: Words, slot: int) -> int:
    """Return how many messages wait for the module in a slot, or are in its hands; arguments as above."""
    return sum(routed - sum(ended) for routed, *ended in _books(words, slot))


def _books(words: Words, slot: int) -> Iterator[list[int]]:
    """Yield for each subscription of a module what was routed, delivered, replaced, dropped and lost."""
    tables = CoreTables.attach(words)
    for index in range(tables.sizes.subscriptions):
        at = tables.subscription(index)
        if not words[at + layout.SUBSCRIPTION_STATE]:
            break
        if words[at + layout.SUBSCRIPTION_SLOT] == slot:
            yield [words[at + layout.SUBSCRIPTION_ROUTED + column] for column in range(5)]
