"""The ledger: every live message, every reference to it, and the outcome of each reference.

A *handle* names a message; a *reference* is one subscription's claim to it. The last store into a row of
either table commits it. The row also carries the new values of all counters that the step changes. So if the
core dies after the commit, `takeover` can finish the step from the row alone; if it dies before the commit,
the step has not happened.
"""

from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, MutableSequence, Sequence
from itertools import compress
from typing import NamedTuple

from robbie_mp.bus.core.directory import Subscription
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.tables import CoreTables, Outcome
from robbie_mp.bus.transport.words import WORD_BYTES, WORD_MAX, row_writer

NO_RECORD = WORD_MAX

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


class HandleRow(NamedTuple):
    """The row of a handle as `open_handle` writes it."""

    handle: Handle
    record: int
    """Number of the outbound record that published the message."""
    publisher_routed: int
    """The publisher's count of routed messages, this one included; likewise the channel's counts."""
    channel_messages: int
    channel_bytes: int


class ReferenceRow(NamedTuple):
    """The row of a reference as `open_references` and `count` write it."""

    state: Outcome
    nth: int
    """The subscription's count of references in that state, this one included."""
    sequence: int
    handle: int
    subscription: int
    pushed_at: int
    """Number of the inbound record that brings it to its module, plus one; 0 while it waits."""


class Ledger:
    """Handles, references and the counters of subscriptions.

    Args:
        tables: the core's tables.

    Attributes:
        give_back: called with a handle that has no reference left.
        handle: returns the live message in a row.
    """

    give_back: Callable[[int], None]

    def __init__(self, tables: CoreTables):
        self._words = tables.words
        self._handle_rows, self._reference_rows = tables.sizes.handles, tables.sizes.references
        self._write_handle = row_writer(tables.words, 9)
        self._write_reference = row_writer(tables.words, 4)
        self._handles_at, self._references_at = tables.handle(0), tables.reference(0)
        self._free_handles = list(range(tables.sizes.handles - 1, -1, -1))
        """Rows; the last one is taken next."""
        self._free_references = list(range(tables.sizes.references - 1, -1, -1))
        self._handles: MutableSequence[Handle] = [Handle(0, 0, 0, 0, 0, 0, 0)] * tables.sizes.handles
        self.handle: Callable[[int], Handle] = self._handles.__getitem__
        self._holders: MutableSequence[int] = [0] * tables.sizes.handles
        self._references: MutableSequence[tuple[int, int, Subscription] | None]
        self._references = [None] * tables.sizes.references

    def has_room(self, references: int) -> bool:
        """Whether there is a row for a message, and rows for this number of references to it."""
        return bool(self._free_handles) and len(self._free_references) >= references

    def open_handle(
        self, handle: Handle, record: int, publisher_routed: int, channel_messages: int, channel_bytes: int
    ) -> int:
        """Enter a message; return the index of its row.

        Args:
            handle: the message.
            record: number of the outbound record that published it.
            publisher_routed: the publisher's count of routed messages, with this one.
            channel_messages: likewise the channel's count.
            channel_bytes: likewise their size in total.
        """
        index = self._free_handles.pop()
        at = self._handles_at + index * _HANDLE_WORDS
        words = self._words
        sequence, source, offset, size, channel_index, stamp_ns, block = handle
        words[at + 1] = NO_RECORD  # a takeover must not take a half-written row for this record's
        self._write_handle(
            (at + 2) * WORD_BYTES,
            source, offset, size, channel_index, stamp_ns, block,
            publisher_routed, channel_messages, channel_bytes,
        )  # fmt: skip
        words[at + 1] = record
        words[at] = sequence  # commits: from here on the message is routed
        self._handles[index] = handle
        return index

    def close_handle(self, index: int) -> None:
        """Free a handle's row."""
        self._words[self._handles_at + index * _HANDLE_WORDS] = 0
        self._free_handles.append(index)

    def live_of_sources(self) -> dict[int, int]:
        """Count the messages that have references, by the incarnation of their publishers; see `live_of`."""
        handles = self._handles
        return Counter(handles[row].source & _SOURCE_OF_INCARNATION for row in self._held())

    def live_of(self, source: int) -> list[int]:
        """Return the rows of a publisher's messages that have references, the oldest first.

        Args:
            source: any data segment of its incarnation, with the number of the segment 0.
        """
        words, first = self._words, self._handles_at
        sources = first + layout.HANDLE_SOURCE
        return sorted(
            [
                row
                for row in self._held()
                if words[sources + row * _HANDLE_WORDS] & _SOURCE_OF_INCARNATION == source
            ],
            key=lambda row: words[first + layout.HANDLE_SEQUENCE + row * _HANDLE_WORDS],
        )

    def size_of(self, handle: int) -> int:
        """Return the size of a live message in bytes, faster than by way of `handle`."""
        return self._words[self._handles_at + handle * _HANDLE_WORDS + layout.HANDLE_BYTES]

    def stamp_ns_of(self, handle: int) -> int:
        """Return the stamp of a live message likewise."""
        return self._words[self._handles_at + handle * _HANDLE_WORDS + layout.HANDLE_STAMP_NS]

    def handle_of(self, reference: int) -> int:
        """Return the message of a live reference, faster than by way of `reference`."""
        return self._words[self._references_at + reference * _REFERENCE_WORDS + layout.REFERENCE_HANDLE]

    def _held(self) -> Iterable[int]:
        """Return the rows of the messages that have references."""
        return compress(range(len(self._holders)), self._holders)

    def holders(self, handle: int) -> int:
        """Return how many references to a message are left."""
        return self._holders[handle]

    def open_references(
        self, subscriptions: Sequence[Subscription], handle: int
    ) -> list[tuple[Subscription, int]]:
        """Enter the claims of subscriptions to a message; return each with the index of its row."""
        opened = []
        sequence = self._handles[handle][0]
        for subscription in subscriptions:
            opened.append((subscription, self.open_late_reference(subscription, handle)))
            self._words[subscription.at + _LAST_SEQUENCE] = sequence
        return opened

    def has_free_reference(self) -> bool:
        """Whether there is a row for one more reference."""
        return bool(self._free_references)

    def open_late_reference(self, subscription: Subscription, handle: int) -> int:
        """Enter the claim of a subscription to a message that has been routed before; return its row.

        The subscription's last sequence stays: the subscription may have had later messages.
        """
        words, sequence = self._words, self._handles[handle][0]
        index = self._free_references.pop()
        at = self._references_at + index * _REFERENCE_WORDS
        routed = words[subscription.at + _ROUTED] + 1
        self._write_reference((at + 1) * WORD_BYTES, sequence, handle, subscription.index, 0)
        words[at] = _HELD | routed << 8  # commits
        words[subscription.at + _ROUTED] = routed
        self._references[index] = (sequence, handle, subscription)
        self._holders[handle] += 1
        return index

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
        """Note the inbound record that is about to bring a reference to its module."""
        self._words[self._references_at + index * _REFERENCE_WORDS + layout.REFERENCE_PUSHED_AT] = record + 1

    def mark_waiting(self, index: int) -> None:
        """Note that a reference waits again: its module died before it began to handle it."""
        self._words[self._references_at + index * _REFERENCE_WORDS + layout.REFERENCE_PUSHED_AT] = 0

    def count(self, index: int, outcome: Outcome) -> None:
        """Enter the outcome of a reference."""
        words, at = self._words, self.reference(index)[2].at + _ROUTED + outcome - 1
        nth = words[at] + 1
        words[self._references_at + index * _REFERENCE_WORDS] = outcome | nth << 8  # commits
        words[at] = nth

    def close_reference(self, index: int) -> None:
        """Free a reference's row; after the last reference, give the message back."""
        handle = self.reference(index)[1]
        self._words[self._references_at + index * _REFERENCE_WORDS] = _FREE
        self._references[index] = None
        self._free_references.append(index)
        self._holders[handle] = left = self._holders[handle] - 1
        if not left:
            self.give_back(handle)

    def finish(self, index: int, outcome: Outcome) -> None:
        """Enter the outcome of a reference and free its row."""
        self.count(index, outcome)
        self.close_reference(index)

    def deliver(self, index: int, handle: int, subscription: Subscription) -> None:
        """Do the same as `finish` with DELIVERED, but faster: almost every reference ends here."""
        words, at = self._words, self._references_at + index * _REFERENCE_WORDS
        count_at = subscription.at + _ROUTED + 1
        nth = words[count_at] + 1
        words[at] = _DELIVERED | nth << 8  # commits
        words[count_at] = nth
        words[at] = _FREE
        self._references[index] = None
        self._free_references.append(index)
        self._holders[handle] = left = self._holders[handle] - 1
        if not left:
            self.give_back(handle)

    # -- reading and adopting rows, for a takeover -------------------------------------------------------

    def live_handles(self) -> list[int]:
        """Return the rows of the table of handles that have a message."""
        words, start = self._words, self._handles_at
        rows = range(self._handle_rows)
        return [index for index in rows if words[start + index * _HANDLE_WORDS]]

    def used_handles(self) -> list[int]:
        """Return the rows of the table of handles that have a message, or had one."""
        words, start = self._words, self._handles_at + layout.HANDLE_SOURCE
        rows = range(self._handle_rows)
        return [index for index in rows if words[start + index * _HANDLE_WORDS]]

    def live_references(self) -> list[int]:
        """Return the rows of the table of references that are not free."""
        words, start = self._words, self._references_at
        rows = range(self._reference_rows)
        return [index for index in rows if words[start + index * _REFERENCE_WORDS]]

    def read_handle(self, index: int) -> HandleRow:
        """Read a row of the table of handles; its sequence is 0 if its message was given back."""
        words, at = self._words, self._handles_at + index * _HANDLE_WORDS
        columns = (words[at + layout.HANDLE_SOURCE + column] for column in range(6))
        return HandleRow(
            Handle(words[at], *columns),
            words[at + layout.HANDLE_RECORD],
            words[at + layout.HANDLE_PUBLISHER_ROUTED],
            words[at + layout.HANDLE_CHANNEL_MESSAGES],
            words[at + layout.HANDLE_CHANNEL_BYTES],
        )

    def read_reference(self, index: int) -> ReferenceRow:
        """Read a row of the table of references."""
        words, at = self._words, self._references_at + index * _REFERENCE_WORDS
        state = words[at]
        return ReferenceRow(
            Outcome(state & 0xFF),
            state >> 8,
            words[at + layout.REFERENCE_SEQUENCE],
            words[at + layout.REFERENCE_HANDLE],
            words[at + layout.REFERENCE_SUBSCRIPTION],
            words[at + layout.REFERENCE_PUSHED_AT],
        )

    def adopt_handles(self, found: Mapping[int, Handle]) -> None:
        """Take over the live messages of a dead core, by the index of their rows."""
        for index, handle in found.items():
            self._handles[index] = handle
        _take_out(self._free_handles, found)

    def adopt_references(self, found: Mapping[int, tuple[int, int, Subscription]]) -> None:
        """Take over a dead core's references (sequence, handle, subscription), by the index of their rows."""
        for index, reference in found.items():
            self._references[index] = reference
            self._holders[reference[1]] += 1
        _take_out(self._free_references, found)

    def is_live(self, handle: int) -> bool:
        """Whether a row of the table of handles has a message."""
        return self._words[self._handles_at + handle * _HANDLE_WORDS] != 0

    def claimants(self, handle: int) -> set[int]:
        """Indices of the subscriptions that have a reference to a message."""
        return {entry[2].index for entry in self._references if entry is not None and entry[1] == handle}

    def was_claimed(self, subscription: Subscription, sequence: int) -> bool:
        """Whether a subscription has had its reference to the message of this sequence."""
        return self._words[subscription.at + layout.SUBSCRIPTION_LAST_SEQUENCE] >= sequence


def _take_out(free: list[int], rows: Container[int]) -> None:
    """Take rows out of those that are free."""
    left = [row for row in free if row not in rows]
    free.clear()
    for row in left:
        free.append(row)
