"""The books: every live message, everyone who still holds or awaits it, and what became of each reference.

A *handle* names a message; a *reference* is one subscription's claim to it. Each row of either table ends in
a committing store, and the row carries the new values of all counters that the step changes, so that a step
cut short after its commit can be finished from the row alone, and one cut short before it never was.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from itertools import compress
from typing import NamedTuple

from robbie_mp.core.directory import Channel, Subscription
from robbie_mp.transport import layout
from robbie_mp.transport.tables import CoreTables
from robbie_mp.transport.words import WORD_BYTES, WORD_MAX, row_writer

NO_RECORD = WORD_MAX


class Outcome(IntEnum):
    """State of a reference; its word holds the count of such events for the subscription from bit 8 on."""

    FREE = 0
    HELD = 1
    DELIVERED = 2
    REPLACED = 3
    DROPPED = 4
    LOST = 5


# Looked up once, not for every message.
_FREE, _HELD, _DELIVERED = int(Outcome.FREE), int(Outcome.HELD), int(Outcome.DELIVERED)
_ROUTED, _LAST_SEQUENCE = layout.SUBSCRIPTION_ROUTED, layout.SUBSCRIPTION_LAST_SEQUENCE
_HANDLE_WORDS, _REFERENCE_WORDS = layout.HANDLE_WORDS, layout.REFERENCE_WORDS
_SOURCE_OF_INCARNATION = layout.SOURCE_OF_INCARNATION


class Handle(NamedTuple):
    """One live message."""

    sequence: int
    source: int
    offset: int
    size: int
    channel: int
    stamp_ns: int
    block: int


class Ledger:
    """Handles, references and the counters of subscriptions.

    Args:
        tables: the core's tables.

    Attributes:
        give_back: called with a handle to which nobody refers any more.
        handle: returns the live message of an index.
    """

    give_back: Callable[[int], None]

    def __init__(self, tables: CoreTables):
        self._tables = tables
        self._words = tables.words
        self._write_handle = row_writer(tables.words, 9)
        self._write_reference = row_writer(tables.words, 4)
        self._handles_at, self._references_at = tables.handle(0), tables.reference(0)
        self._free_handles = list(range(tables.sizes.handles - 1, -1, -1))
        """Rows; the last one is taken next."""
        self._free_references = list(range(tables.sizes.references - 1, -1, -1))
        self._handles: list[Handle] = [Handle(0, 0, 0, 0, 0, 0, 0)] * tables.sizes.handles
        self.handle = self._handles.__getitem__
        self._holders = [0] * tables.sizes.handles
        self._references: list[tuple[int, int, Subscription] | None] = [None] * tables.sizes.references
        self._live_of_source: dict[int, int] = {}
        """Number of live messages of each incarnation of a publisher."""

    def has_room(self, references: int) -> bool:
        """Whether a message with so many subscribers can be entered."""
        return bool(self._free_handles) and len(self._free_references) >= references

    def open_handle(self, handle: Handle, record: int, publisher_routed: int, channel: Channel) -> int:
        """Enter a message; return the index of its row."""
        index = self._free_handles.pop()
        at = self._handles_at + index * _HANDLE_WORDS
        words = self._words
        sequence, source, offset, size, channel_index, stamp_ns, block = handle
        words[at + 1] = NO_RECORD  # a row half written must not seem to be for its record
        self._write_handle(
            (at + 2) * WORD_BYTES,
            source, offset, size, channel_index, stamp_ns, block,
            publisher_routed, channel.messages + 1, channel.bytes + size,
        )  # fmt: skip
        words[at + 1] = record
        words[at] = sequence  # commits: from here on the message is routed
        self._handles[index] = handle
        source &= _SOURCE_OF_INCARNATION
        self._live_of_source[source] = self._live_of_source.get(source, 0) + 1
        return index

    def close_handle(self, index: int) -> int:
        """Free a handle's row; return how many messages of its publisher are left."""
        self._words[self._handles_at + index * _HANDLE_WORDS] = 0
        self._free_handles.append(index)
        source = self._handles[index][1] & _SOURCE_OF_INCARNATION
        self._live_of_source[source] = left = self._live_of_source[source] - 1
        return left

    def forget_source(self, slot: int, incarnation: int) -> None:
        """Forget a dead publisher that has no messages left."""
        self._live_of_source.pop(layout.pack_source(slot, 0, incarnation), None)

    def sources(self) -> set[tuple[int, int]]:
        """Slot and incarnation of every publisher with live messages."""
        return {_publisher(source) for source, live in self._live_of_source.items() if live}

    def has_live(self, slot: int, incarnation: int) -> bool:
        """Whether messages of that publisher are alive."""
        return self._live_of_source.get(layout.pack_source(slot, 0, incarnation), 0) > 0

    def live_of(self, source: int) -> list[int]:
        """Return the rows of a publisher's messages that are wanted or held, the oldest first."""
        rows = compress(range(len(self._holders)), self._holders)
        handles = self._handles
        return sorted(
            [row for row in rows if handles[row].source & _SOURCE_OF_INCARNATION == source],
            key=lambda row: handles[row].sequence,
        )

    def holders(self, handle: int) -> int:
        """Return how many references to a message are left."""
        return self._holders[handle]

    def open_references(
        self, subscriptions: Sequence[Subscription], handle: int
    ) -> list[tuple[Subscription, int]]:
        """Enter the claims of subscriptions to a message; return each with the index of its row."""
        opened = []
        words = self._words
        sequence = self._handles[handle][0]
        for subscription in subscriptions:
            index = self._free_references.pop()
            at = self._references_at + index * _REFERENCE_WORDS
            counts = subscription.counts
            counts[0] = routed = counts[0] + 1
            self._write_reference((at + 1) * WORD_BYTES, sequence, handle, subscription.index, 0)
            words[at] = _HELD | routed << 8  # commits
            words[subscription.at + _ROUTED] = routed
            words[subscription.at + _LAST_SEQUENCE] = sequence
            self._references[index] = (sequence, handle, subscription)
            self._holders[handle] += 1
            opened.append((subscription, index))
        return opened

    def reference(self, index: int) -> tuple[int, int, Subscription]:
        """Sequence, handle and subscription of a live reference.

        Raises:
            KeyError: there is no such reference.
        """
        entry = self._references[index]
        if entry is None:
            raise KeyError(f"reference {index} is not live")
        return entry

    def mark_pushed(self, index: int, record: int) -> None:
        """Note which inbound record is about to bring a reference to its module."""
        self._words[self._references_at + index * _REFERENCE_WORDS + layout.REFERENCE_PUSHED_AT] = record + 1

    def mark_waiting(self, index: int) -> None:
        """Note that a reference waits again: its module died before it began to handle it."""
        self._words[self._references_at + index * _REFERENCE_WORDS + layout.REFERENCE_PUSHED_AT] = 0

    def count(self, index: int, outcome: Outcome) -> None:
        """Enter what became of a reference."""
        subscription = self.reference(index)[2]
        column = outcome - 1
        subscription.counts[column] = nth = subscription.counts[column] + 1
        self._words[self._references_at + index * _REFERENCE_WORDS] = outcome | nth << 8  # commits
        self._words[subscription.at + _ROUTED + column] = nth

    def close_reference(self, index: int) -> None:
        """Free a reference's row, and give the message back if it was the last."""
        handle = self.reference(index)[1]
        self._words[self._references_at + index * _REFERENCE_WORDS] = _FREE
        self._references[index] = None
        self._free_references.append(index)
        self._holders[handle] = left = self._holders[handle] - 1
        if not left:
            self.give_back(handle)

    def finish(self, index: int, outcome: Outcome) -> None:
        """Enter what became of a reference and free it."""
        self.count(index, outcome)
        self.close_reference(index)

    def deliver(self, index: int, handle: int, subscription: Subscription) -> None:
        """Do as `finish` with DELIVERED, in fewer steps: it happens to almost every reference."""
        words, at, counts = self._words, self._references_at + index * _REFERENCE_WORDS, subscription.counts
        counts[1] = nth = counts[1] + 1
        words[at] = _DELIVERED | nth << 8  # commits
        words[subscription.at + _ROUTED + 1] = nth
        words[at] = _FREE
        self._references[index] = None
        self._free_references.append(index)
        self._holders[handle] = left = self._holders[handle] - 1
        if not left:
            self.give_back(handle)

    # -- after a crash of the core -----------------------------------------------------------------------

    def read_handles(self) -> list[int]:
        """Find the messages that a dead core left; return the indices of their rows."""
        found = []
        words = self._words
        for index in range(self._tables.sizes.handles):
            at = self._handles_at + index * _HANDLE_WORDS
            if words[at]:
                columns = (words[at + layout.HANDLE_SOURCE + column] for column in range(6))
                handle = self._handles[index] = Handle(words[at], *columns)
                source = handle.source & _SOURCE_OF_INCARNATION
                self._live_of_source[source] = self._live_of_source.get(source, 0) + 1
                found.append(index)
        alive = set(found)
        self._free_handles[:] = [row for row in self._free_handles if row not in alive]
        return found

    def read_references(self, subscriptions: Sequence[Subscription]) -> list[tuple[int, Outcome]]:
        """Find the references that a dead core left, and complete the counts they carry.

        Returns:
            Row and state of each; one with an outcome other than DELIVERED is still to be closed.
        """
        found = []
        words = self._words
        for index in range(self._tables.sizes.references):
            at = self._references_at + index * _REFERENCE_WORDS
            if not words[at]:
                continue
            state, nth = Outcome(words[at] & 0xFF), words[at] >> 8
            subscription = subscriptions[words[at + layout.REFERENCE_SUBSCRIPTION]]
            handle = words[at + layout.REFERENCE_HANDLE]
            self._references[index] = (words[at + layout.REFERENCE_SEQUENCE], handle, subscription)
            self._holders[handle] += 1
            self._complete_count(subscription, state - 1, nth)
            found.append((index, state))
        alive = {index for index, _ in found}
        self._free_references[:] = [row for row in self._free_references if row not in alive]
        return found

    def _complete_count(self, subscription: Subscription, column: int, nth: int) -> None:
        if subscription.counts[column] < nth:
            subscription.counts[column] = nth
            self._words[subscription.at + layout.SUBSCRIPTION_ROUTED + column] = nth

    def pushed_at(self, index: int) -> int:
        """Number of the inbound record that was to bring a reference, plus one; 0 if it waits."""
        return self._words[self._references_at + index * _REFERENCE_WORDS + layout.REFERENCE_PUSHED_AT]

    def is_held(self, handle: int) -> bool:
        """Whether any reference to a message is left."""
        return self._holders[handle] > 0

    def claimants(self, handle: int) -> set[int]:
        """Indices of the subscriptions that have a reference to a message."""
        return {entry[2].index for entry in self._references if entry is not None and entry[1] == handle}

    def was_claimed(self, subscription: Subscription, sequence: int) -> bool:
        """Whether a subscription has had its reference to the message of this sequence."""
        return self._words[subscription.at + layout.SUBSCRIPTION_LAST_SEQUENCE] >= sequence

    def entered(self, routed: Sequence[int]) -> set[tuple[int, int, int]]:
        """Slot, incarnation and outbound record of every message of which a row tells that it was entered.

        The row of a message that was given back tells it still; so does one that was never committed seem to,
        but its publisher's count has not got there.

        Args:
            routed: how many messages of each slot were routed to their end.
        """
        found = set()
        words = self._words
        for index in range(self._tables.sizes.handles):
            at = self._handles_at + index * _HANDLE_WORDS
            source = words[at + layout.HANDLE_SOURCE]
            slot = source & 0xFFFF
            if words[at] or (source and routed[slot] >= words[at + layout.HANDLE_PUBLISHER_ROUTED]):
                found.add((slot, source >> 32, words[at + layout.HANDLE_RECORD]))
        return found

    def row(self, handle: int, column: int) -> int:
        """A word of a handle's row."""
        return self._words[self._tables.handle(handle) + column]


def _publisher(source: int) -> tuple[int, int]:
    """Slot and incarnation of a publisher."""
    slot, _, incarnation = layout.unpack_source(source)
    return slot, incarnation
