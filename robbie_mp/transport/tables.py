"""The core's tables in shared memory: where each row lies."""

from dataclasses import dataclass

from robbie_mp.transport import layout
from robbie_mp.transport.words import Words


@dataclass(frozen=True)
class TableSizes:
    """Rows of each table."""

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
        sizes: rows of each table.
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
        """Write the sizes into a fresh segment, so that whoever attaches finds the tables."""
        words[layout.CORE_SLOTS] = sizes.slots
        words[layout.CORE_CHANNELS] = sizes.channels
        words[layout.CORE_SUBSCRIPTIONS] = sizes.subscriptions
        words[layout.CORE_HANDLES] = sizes.handles
        words[layout.CORE_REFERENCES] = sizes.references
        return cls(words, sizes)

    @classmethod
    def attach(cls, words: Words) -> "CoreTables":
        """Find the tables of an existing segment."""
        return cls(
            words,
            TableSizes(
                words[layout.CORE_SLOTS],
                words[layout.CORE_CHANNELS],
                words[layout.CORE_SUBSCRIPTIONS],
                words[layout.CORE_HANDLES],
                words[layout.CORE_REFERENCES],
            ),
        )

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
