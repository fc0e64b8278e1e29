"""The receiving end of a stream: takes each packet at most once, in order, and puts messages together."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import NamedTuple

import zstandard

from robbie_mp.connect.link.counts import HANDLING, NEXT, CountRow
from robbie_mp.connect.link.header import COMPRESSED, LATCHED, MAX_COUNTS, ChannelId, DataHeader
from robbie_mp.connect.link.traffic import MANNERS, TrafficClass

MAX_KEPT_BYTES = 1 << 20
"""Of packets that come while a message waits for room; more than any sender has under way."""
KEPT_OVERHEAD_BYTES = 1000
"""The size that each of them counts besides what it carries."""
RETRY_FACTOR = 10
"""A message without room is tried again after this many times as long as the last attempt took."""


class Fate(Enum):
    """The fate of a message that has arrived."""

    PUBLISHED = auto()
    REFUSED = auto()
    """It is dropped: too late, not allowed, or not a message."""
    NO_ROOM = auto()
    """It cannot be published now."""


class Arrived(NamedTuple):
    """A whole message, as it has arrived."""

    robot: str
    """The robot that has sent it."""
    session: int
    traffic: TrafficClass
    number: int
    name: ChannelId
    data: bytes
    stamp_ns: int
    """When it was published, by the clock of that robot."""
    type_hash: int
    is_latched: bool


@dataclass(slots=True)
class _Parts:
    """The parts of a message that have arrived."""

    first: DataHeader
    data: bytearray = field(default_factory=bytearray)


class ReceiveStream:
    """Takes the packets of one class of one session.

    Args:
        traffic: the class.
        row: where its progress is kept, in memory that outlives this process.
        handle: publishes a message, or refuses it.
        max_bytes: size of the largest message, before it was compressed.

    Attributes:
        duplicates: packets that had been taken already, or that came after newer ones of their channel.
        is_told: whether the sender knows of everything that has been taken.
        told_ns: when it was last told.
        untold_bytes: what has arrived since.
        newest: the greatest number of a sending that has arrived.
    """

    def __init__(
        self, traffic: TrafficClass, row: CountRow, handle: Callable[[Arrived], Fate], max_bytes: int
    ) -> None:
        self.traffic = traffic
        self._row = row
        self._handle = handle
        self._max_bytes = max_bytes
        self._parts: _Parts | None = None
        self._blocked: Arrived | None = None
        """A message that there was no room for,"""
        self._blocked_at = 0
        """the sequence of its last packet, and"""
        self._retry_ns = 0
        """when it is tried again."""
        self._kept: deque[tuple[DataHeader, bytes]] = deque()
        """Packets that have come since then."""
        self._kept_bytes = 0
        self._is_in_order = MANNERS[traffic].is_resent
        self.duplicates = 0
        self.is_told = False
        self.told_ns = 0
        self.untold_bytes = 0
        self.misses = False
        """Whether the newest packet could not be taken, because one before it is missing."""
        if row[HANDLING]:  # a process was killed while it published this message: not again
            row[NEXT] = max(row[NEXT], row[HANDLING] + 1)
            row[HANDLING] = 0
        elif not row[NEXT]:
            row[NEXT] = 1
        self.next = row[NEXT]
        self.newest = 0
        self._overtaken_from = self.next
        """Packets with a lower sequence are never taken."""
        self._newest_of: dict[int, int] = {}
        """Last sequence of the newest message taken of each channel, where none is sent again in order."""
        self._again: _Parts | None = None
        """The parts of a message that others have overtaken, and"""
        self._again_next = 0
        """the sequence of its next part."""

    @property
    def handled(self) -> int:
        """Sequence of the first packet whose message has not been handled."""
        return self._row[NEXT]

    def take(self, header: DataHeader, payload: bytes) -> None:
        """Take a packet, if it is the next one.

        Where the newest counts, take it if it is newer than all of its channel. Other channels may have
        overtaken it, if the network has changed the order, or if it is sent again.

        While a message waits for room, nothing is taken or told, so the sender's window fills, and it stops.
        """
        if self._blocked is not None:
            self._keep(header, payload)
            return
        self.is_told = False
        self.untold_bytes += len(payload)
        self.newest = max(self.newest, header.sending)
        self.misses = False
        if header.sequence < self.next:
            if self._is_overtaken(header):
                self._take_overtaken(header, payload)
            else:
                self.duplicates += 1
            return
        if header.sequence > self.next:
            if self._is_in_order and header.oldest <= self.next:
                self.misses = True
                return  # the missing one will be sent again, and then this one
            self._parts = None
            if self._is_in_order and header.sequence != header.oldest:
                self._skip_to(header.oldest)
                self.misses = True
                return
            self._skip_to(header.sequence)
        if header.is_mark or not self._add(header, payload):
            self._skip_to(header.sequence + 1)
            return
        if header.start + len(payload) < header.whole:
            self.next = header.sequence + 1
            return
        self._finish(header.sequence)

    def _keep(self, header: DataHeader, payload: bytes) -> None:
        """Keep a packet that comes while a message waits; what there is no room for will be sent again."""
        newest = self._kept[-1][0].sequence if self._kept else self._blocked_at
        size = KEPT_OVERHEAD_BYTES + len(payload)
        if header.sequence > newest and self._kept_bytes + size <= MAX_KEPT_BYTES:
            self._kept_bytes += size
            self._kept.append((header, payload))

    def go_on(self, now_ns: int) -> None:
        """Publish the message that waits for room, if there is some now, and take what has come since."""
        if self._blocked is None or now_ns < self._retry_ns:
            return
        begun_ns = time.monotonic_ns()
        if not self._settle(self._blocked_at, self._blocked):
            self._retry_ns = now_ns + RETRY_FACTOR * (time.monotonic_ns() - begun_ns)
            return
        self._blocked, self.is_told = None, False
        while self._kept and self._blocked is None:
            header, payload = self._kept.popleft()
            self._kept_bytes -= KEPT_OVERHEAD_BYTES + len(payload)
            self.take(header, payload)

    def _is_overtaken(self, header: DataHeader) -> bool:
        """Whether it belongs to a message, newer than all of its channel, that others have overtaken."""
        if self._is_in_order or header.is_mark:
            return False
        first = header
        if header.start:
            if self._again is None or header.sequence != self._again_next:
                return False
            first = self._again.first
        return first.sequence >= max(self._overtaken_from, self._newest_of.get(first.channel, 0) + 1)

    def _take_overtaken(self, header: DataHeader, payload: bytes) -> None:
        begun, self._parts = self._parts, self._again
        self._again_next = header.sequence + 1
        if self._add(header, payload) and header.start + len(payload) == header.whole:
            self._finish(header.sequence)
        self._parts, self._again = begun, self._parts

    def _note(self, channel: int, sequence: int) -> None:
        if channel not in self._newest_of and len(self._newest_of) >= MAX_COUNTS:
            self._newest_of.clear()
            self._overtaken_from = self.next
        self._newest_of[channel] = sequence

    def _skip_to(self, sequence: int) -> None:
        self._row[NEXT] = self.next = sequence

    def _add(self, header: DataHeader, payload: bytes) -> bool:
        """Add a part to its message; False if it belongs to none, or the message is too large."""
        if header.start == 0:
            self._parts = _Parts(header)
        parts = self._parts
        if parts is None:
            return False  # its first part was lost
        if (
            header.start != len(parts.data)
            or header.whole != parts.first.whole
            or not bool(header.whole) <= len(payload) <= header.whole - header.start
            or header.whole > self._max_bytes
        ):
            self._parts = None
            return False
        parts.data += payload
        return True

    def _finish(self, sequence: int) -> None:
        parts = self._parts
        assert parts is not None
        message = self._put_together(parts)
        if not self._is_in_order:
            self._note(parts.first.channel, sequence)
        self._parts = None
        if self._settle(sequence, message):
            return
        if self._is_in_order:
            self._blocked, self._blocked_at, self._retry_ns = message, sequence, 0
            self.next = sequence + 1
        else:  # a newer one comes soon
            self._skip_to(max(self.next, sequence + 1))

    def _settle(self, sequence: int, message: Arrived | None) -> bool:
        """Publish or drop a message; False if there is no room for it now."""
        if message is not None:
            self._row[HANDLING] = sequence
            if self._handle(message) is Fate.NO_ROOM:
                self._row[HANDLING] = 0
                return False
        self._skip_to(max(self.next, sequence + 1))
        self._row[HANDLING] = 0
        return True

    def _put_together(self, parts: _Parts) -> Arrived | None:
        first = parts.first
        data = self._decompress(parts.data, first.size) if first.flags & COMPRESSED else bytes(parts.data)
        if first.name is None or len(data) != first.size:
            return None
        return Arrived(
            first.robot,
            first.session,
            self.traffic,
            first.channel,
            first.name,
            data,
            first.stamp_ns,
            first.type_hash,
            bool(first.flags & LATCHED),
        )

    def _decompress(self, data: bytearray, size: int) -> bytes:
        """Return the data, or nothing if it is damaged or larger than it says."""
        if size > self._max_bytes:
            return b""
        try:
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))
        except zstandard.ZstdError:
            return b""
