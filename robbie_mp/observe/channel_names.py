"""Type, version and topic of each channel, from the core's tables."""

from robbie_mp.transport.tables import ChannelName, CoreTables
from robbie_mp.transport.words import Words


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
