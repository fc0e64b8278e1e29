"""What has passed through each channel, as the core counts it; reading it costs the robot nothing."""

from dataclasses import dataclass

from robbie_mp.core.directory import ROW_OPEN
from robbie_mp.core.tables import CoreTables
from robbie_mp.transport import layout
from robbie_mp.transport.layout import NAME_WORDS
from robbie_mp.transport.words import Words, read_text


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

    def read(self, type_name: str, version: int, topic: str = "") -> dict[str, ChannelCount]:
        """Return the counts of a type's channels by topic, of one topic or of all ('')."""
        words = self._words
        found = {}
        for index in range(self._tables.sizes.channels):
            at = self._tables.channel(index)
            if words[at + layout.CHANNEL_STATE] != ROW_OPEN:
                break
            if words[at + layout.CHANNEL_VERSION] != version:
                continue
            if read_text(words, at + layout.CHANNEL_TYPE, NAME_WORDS) != type_name:
                continue
            of_topic = read_text(words, at + layout.CHANNEL_TOPIC, NAME_WORDS)
            if topic in ("", of_topic):
                found[of_topic] = ChannelCount(
                    words[at + layout.CHANNEL_MESSAGES],
                    words[at + layout.CHANNEL_BYTES],
                    words[at + layout.CHANNEL_LAST_STAMP_NS],
                    words[at + layout.CHANNEL_INTERVALS_SQUARED],
                )
        return found
