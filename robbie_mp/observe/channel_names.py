"""What the messages of each channel are, as the core's tables say."""

from robbie_mp.transport import layout
from robbie_mp.transport.endpoint import ChannelName
from robbie_mp.transport.layout import NAME_WORDS
from robbie_mp.transport.tables import CoreTables
from robbie_mp.transport.words import Words, read_text


class ChannelNames:
    """Reads each channel's row once: channels are never closed or renamed.

    Args:
        words: the core segment.
    """

    def __init__(self, words: Words):
        self._words = words
        self._tables = CoreTables.attach(words)
        self._known: dict[int, ChannelName] = {}

    def __call__(self, channel: int) -> ChannelName:
        """Say what the messages of a channel are; the core has opened it before it sent any of them."""
        known = self._known.get(channel)
        if known is None:
            words, at = self._words, self._tables.channel(channel)
            known = self._known[channel] = ChannelName(
                read_text(words, at + layout.CHANNEL_TYPE, NAME_WORDS),
                words[at + layout.CHANNEL_VERSION],
                read_text(words, at + layout.CHANNEL_TOPIC, NAME_WORDS),
            )
        return known
