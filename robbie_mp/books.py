"""What the core's books say of one subscriber, and of every channel; reading them costs the robot nothing."""

from robbie_mp.core.directory import ROW_OPEN
from robbie_mp.core.tables import CoreTables
from robbie_mp.transport import layout
from robbie_mp.transport.endpoint import ChannelName
from robbie_mp.transport.layout import NAME_WORDS
from robbie_mp.transport.words import Words, read_text


class BookReader:
    """Reads the core's books.

    Args:
        words: the core segment.
        slot: of the subscriber.
    """

    def __init__(self, words: Words, slot: int):
        self._words = words
        self._tables = CoreTables.attach(words)
        self._slot = slot

    def missed(self) -> int:
        """Return how many messages the subscriber will never get.

        Its queue was full, or they were in the hands of a process of its that died.
        """
        words, missed = self._words, 0
        for index in range(self._tables.sizes.subscriptions):
            at = self._tables.subscription(index)
            if not words[at + layout.SUBSCRIPTION_STATE]:
                break
            if words[at + layout.SUBSCRIPTION_SLOT] == self._slot:
                missed += words[at + layout.SUBSCRIPTION_DROPPED] + words[at + layout.SUBSCRIPTION_LOST]
        return missed

    def channels(self) -> dict[ChannelName, int]:
        """Return how many messages have passed through each channel."""
        words, found = self._words, {}
        for index in range(self._tables.sizes.channels):
            at = self._tables.channel(index)
            if words[at + layout.CHANNEL_STATE] != ROW_OPEN:
                break
            name = ChannelName(
                read_text(words, at + layout.CHANNEL_TYPE, NAME_WORDS),
                words[at + layout.CHANNEL_VERSION],
                read_text(words, at + layout.CHANNEL_TOPIC, NAME_WORDS),
            )
            found[name] = words[at + layout.CHANNEL_MESSAGES]
        return found
