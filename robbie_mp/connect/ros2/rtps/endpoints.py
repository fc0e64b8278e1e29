"""Reliable writers and readers of RTPS: what is lost is sent again, and nothing comes twice."""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from robbie_mp.base.token_bucket import TokenBucket
from robbie_mp.connect.ros2.rtps import wire

Send = Callable[[bytes, list[bytes]], None]
"""Sends submessages to a participant, each list in as few datagrams as possible."""
KEPT: Final = 64
"""Messages that a writer of responses keeps for readers that have missed them."""
MAX_PEERS: Final = 1000
"""Most endpoints of others that one of this side has to do with."""
AGAIN_BYTES_PER_S: Final = 4 << 20
"""What a reader may be sent again: anybody can ask, in a datagram of some 60 bytes, for all that is kept."""
FASTDDS: Final = b"\x01\x0f"
"""The number of its vendor, with which the GUIDs of its participants begin."""
GREETING_S: Final = 0.3
"""After this time, a writer knows a reader that knows the writer."""
MAX_PARTIAL: Final = 4
"""Most messages of which a reader has only parts; the oldest goes first."""
MAX_AHEAD: Final = wire.MAX_BITS
"""Most numbers that a reader remembers beyond the first that it misses."""


class Written(NamedTuple):
    """A message that a writer keeps.

    Attributes:
        to: the participant that it is for; empty: all.
    """

    parameters: bytes
    payload: bytes
    to: bytes


@dataclass
class _ReaderProxy:
    """A reader of another participant: what it needs, and what it has."""

    first: int
    acknowledged: int
    again: TokenBucket = field(default_factory=lambda: TokenBucket(AGAIN_BYTES_PER_S, AGAIN_BYTES_PER_S))
    """Bytes that it may be sent again now."""


@dataclass
class ReliableWriter:
    """A reliable writer.

    Args:
        entity: its number in its participant.
        send: sends to a participant.
        is_latched: whether readers that come later get what is kept.
        kept: number of messages that are kept.

    Attributes:
        withheld: messages that were not sent again at once, because their reader had got too many again.
    """

    entity: bytes
    send: Send
    is_latched: bool = False
    kept: int = KEPT
    readers: dict[bytes, _ReaderProxy] = field(default_factory=dict)
    _history: "OrderedDict[int, Written]" = field(default_factory=OrderedDict)
    withheld: int = 0
    _last: int = 0
    _count: int = 0

    @property
    def next(self) -> int:
        """The number of the next message."""
        return self._last + 1

    def match(self, reader: bytes) -> None:
        """Begin to send to a reader."""
        if reader not in self.readers and len(self.readers) < MAX_PEERS:
            done = 0 if self.is_latched else self._last
            self.readers[reader] = _ReaderProxy(done + 1, done)
            self._send(reader, (self._heartbeat(reader),))

    def write(self, payload: bytes, parameters: bytes = b"", to: bytes = b"") -> int:
        """Send a message to the readers of all participants, or of one; return its number."""
        self._last += 1
        self._history[self._last] = Written(parameters, payload, to)
        if len(self._history) > self.kept:
            self._history.popitem(last=False)
        for reader in self.readers:
            self._send(reader, (*self._parts(reader, self._last), self._heartbeat(reader)))
        return self._last

    def on_acknack(self, reader: bytes, base: int, missing: list[int]) -> None:
        """Send again what a reader misses; if that is too much for now, it asks for the rest again."""
        proxy = self.readers.get(reader)
        if proxy is None:
            return
        proxy.acknowledged = max(proxy.acknowledged, min(base - 1, self._last))
        parts: list[bytes] = []
        for one in missing:
            if not 0 < one <= self._last:
                continue
            if proxy.again.wait_s:
                self.withheld += 1
                continue
            found = list(self._parts(reader, one))
            proxy.again.spend(sum(map(len, found)))
            parts += found
        if parts or base <= self._last:
            self._send(reader, (*parts, self._heartbeat(reader)))

    def look_after(self) -> None:
        """Ask readers that have not confirmed everything; called a few times in a second."""
        for reader, proxy in self.readers.items():
            if proxy.acknowledged < self._last:
                self._send(reader, (self._heartbeat(reader),))

    def forget(self, prefix: bytes) -> None:
        """Forget a reader, or all of a participant."""
        for one in [one for one in self.readers if one.startswith(prefix)]:
            del self.readers[one]

    def _parts(self, reader: bytes, sequence: int) -> Iterator[bytes]:
        written, entity = self._history.get(sequence), reader[wire.PREFIX_BYTES :]
        if written is None or sequence < self.readers[reader].first:
            return  # The heartbeat says so. A GAP hangs FastDDS (2.14, 3.2) if it has parts of the message.
        if written.to and not reader.startswith(written.to):
            yield wire.gap(entity, self.entity, sequence)
            return
        yield from wire.data_parts(entity, self.entity, sequence, written.parameters, written.payload)

    def _heartbeat(self, reader: bytes) -> bytes:
        self._count += 1
        first = max(next(iter(self._history), self._last + 1), self.readers[reader].first)
        return wire.heartbeat(reader[wire.PREFIX_BYTES :], self.entity, first, self._last, self._count)

    def _send(self, reader: bytes, parts: tuple[bytes, ...]) -> None:
        self.send(reader[: wire.PREFIX_BYTES], list(parts))


@dataclass
class Partial:
    """A message of which only parts have come.

    Attributes:
        parts: the parts, by their number.
        parameters: the parameters before the message.
        sent_ns: the earliest time that a part of it was sent, as far as the parts say that.
        size: bytes that have come.
    """

    parts: dict[int, bytes] = field(default_factory=dict)
    parameters: dict[int, bytes] = field(default_factory=dict)
    sent_ns: int | None = None
    size: int = 0

    def add(self, sample: wire.Sample, total: int) -> int:
        """Add parts, and return how many bytes they are. One that is sent again may be dated later."""
        times = [one for one in (self.sent_ns, sample.sent_ns) if one is not None]
        self.sent_ns = min(times, default=None)
        self.parameters = self.parameters or sample.parameters
        before = self.size
        for number, at in enumerate(range(0, len(sample.payload), sample.fragment_bytes), sample.fragment):
            if number <= total and number not in self.parts:
                part = self.parts[number] = sample.payload[at : at + sample.fragment_bytes]
                self.size += len(part)
        return self.size - before


class PartBudget:
    """Bounds the parts of messages that have not come whole, of all readers of a participant.

    If they are too many, the other participant that has sent most of them loses its oldest message.

    Args:
        max_bytes: most bytes of parts.
    """

    def __init__(self, max_bytes: int):
        self._max_bytes = max_bytes
        self._kept: dict[bytes, OrderedDict[tuple[int, int], _WriterProxy]] = {}
        self._sizes: dict[bytes, int] = {}

    def note(self, sender: bytes, proxy: "_WriterProxy", sequence: int, size: int) -> None:
        """Count further bytes of an incomplete message from a participant."""
        self._kept.setdefault(sender, OrderedDict())[id(proxy), sequence] = proxy
        self._sizes[sender] = self._sizes.get(sender, 0) + size
        while sum(self._sizes.values()) > self._max_bytes:
            most = max(self._sizes, key=self._sizes.__getitem__)
            (_, oldest), owner = next(iter(self._kept[most].items()))
            self.drop(most, owner, oldest)

    def drop(self, sender: bytes, proxy: "_WriterProxy", sequence: int) -> None:
        """Drop the parts of a message."""
        partial = proxy.partial.pop(sequence, None)
        if partial is None:
            return
        self._sizes[sender] -= partial.size
        del self._kept[sender][id(proxy), sequence]
        if not self._kept[sender]:
            del self._kept[sender], self._sizes[sender]


@dataclass
class _WriterProxy:
    """A writer of another participant: what has come of it."""

    base: int = 1
    """The first number that is missing."""
    ahead: set[int] = field(default_factory=set)
    partial: "OrderedDict[int, Partial]" = field(default_factory=OrderedDict)
    count: int = 0
    is_met: bool = False
    """Whether it has sent something, so that it knows this reader."""
    since_s: float = field(default_factory=time.monotonic)

    @property
    def knows_reader(self) -> bool:
        """Whether it knows this reader; one that has never written anything need not say so."""
        return self.is_met or time.monotonic() - self.since_s >= GREETING_S

    def is_new(self, sequence: int) -> bool:
        return self.base <= sequence < self.base + MAX_AHEAD and sequence not in self.ahead

    def note(self, sequence: int) -> None:
        self.ahead.add(sequence)
        self.skip_to(self.base)

    def skip_to(self, base: int) -> None:
        self.base = max(self.base, base)
        self.ahead = {one for one in self.ahead if one >= self.base}
        while self.base in self.ahead:
            self.ahead.remove(self.base)
            self.base += 1


@dataclass
class ReliableReader:
    """A reliable reader.

    Args:
        entity: its number in its participant.
        send: sends to a participant.
        take: gets each message once.
        max_bytes: size of the largest message that it takes.
        budget: bounds the parts of messages; None: those of this reader only.
        on_oversized: called for each message that is too large.
    """

    entity: bytes
    send: Send
    take: Callable[[wire.Sample], None]
    max_bytes: int = 1 << 20
    budget: PartBudget | None = None
    on_oversized: Callable[[], None] = lambda: None
    writers: dict[bytes, _WriterProxy] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._budget = self.budget or PartBudget(MAX_PARTIAL * self.max_bytes)

    def match(self, writer: bytes) -> None:
        """Begin to listen to a writer."""
        if writer not in self.writers and len(self.writers) < MAX_PEERS:
            self.writers[writer] = _WriterProxy()
            self._greet(writer)  # what it has sent before comes at once

    def look_after(self) -> None:
        """Greet writers that have not sent anything yet; called a few times in a second."""
        for writer, proxy in self.writers.items():
            if not proxy.knows_reader:
                self._greet(writer)

    def on_sample(self, sample: wire.Sample) -> None:
        """Take a message, or a part of one."""
        proxy = self.writers.get(sample.writer)
        if proxy is None or not proxy.is_new(sample.sequence):
            return
        proxy.is_met = True
        whole = self._whole(proxy, sample) if sample.fragment else sample
        if whole is not None:
            proxy.note(sample.sequence)
            self.take(whole)

    def _whole(self, proxy: _WriterProxy, sample: wire.Sample) -> wire.Sample | None:
        if sample.size > self.max_bytes:
            proxy.note(sample.sequence)
            self.on_oversized()
            return None
        sender, sequence = sample.writer[: wire.PREFIX_BYTES], sample.sequence
        total = -(-sample.size // sample.fragment_bytes)
        partial = proxy.partial.setdefault(sequence, Partial())
        self._budget.note(sender, proxy, sequence, partial.add(sample, total))
        if len(proxy.partial) > MAX_PARTIAL:
            self._budget.drop(sender, proxy, next(iter(proxy.partial)))
        is_whole = sequence in proxy.partial and len(partial.parts) >= total
        if not is_whole or any(one not in partial.parts for one in range(1, total + 1)):
            return None
        self._budget.drop(sender, proxy, sequence)
        data = b"".join(partial.parts[one] for one in range(1, total + 1))
        return sample._replace(
            payload=data[: sample.size], parameters=partial.parameters, sent_ns=partial.sent_ns
        )

    def on_heartbeat(self, writer: bytes, first: int, last: int, is_final: bool) -> None:
        """Tell a writer what is missing."""
        proxy = self.writers.get(writer)
        if proxy is None:
            return
        proxy.is_met = True
        proxy.skip_to(first)
        end = min(last + 1, proxy.base + wire.MAX_BITS)
        missing = [one for one in range(proxy.base, end) if one not in proxy.ahead]
        if missing or not is_final:
            self._acknowledge(writer, missing)

    def on_gap(self, writer: bytes, start: int, base: int, single: list[int]) -> None:
        """Note numbers that bring nothing."""
        proxy = self.writers.get(writer)
        if proxy is None:
            return
        if start <= proxy.base:
            proxy.skip_to(base)
        else:
            single = [*range(start, min(base, start + MAX_AHEAD)), *single]
        for one in single:
            if proxy.is_new(one):
                proxy.note(one)

    def forget(self, prefix: bytes) -> None:
        """Forget a writer, or all of a participant."""
        for one in [one for one in self.writers if one.startswith(prefix)]:
            proxy = self.writers.pop(one)
            for sequence in list(proxy.partial):
                self._budget.drop(one[: wire.PREFIX_BYTES], proxy, sequence)

    def _greet(self, writer: bytes) -> None:
        """Ask a writer for what it has. FastDDS answers at once only to 0, which CycloneDDS refuses."""
        base = 0 if writer.startswith(FASTDDS) else self.writers[writer].base
        self._tell(writer, base, [], is_final=False)

    def _acknowledge(self, writer: bytes, missing: list[int]) -> None:
        self._tell(writer, self.writers[writer].base, missing, is_final=True)

    def _tell(self, writer: bytes, base: int, missing: list[int], *, is_final: bool) -> None:
        proxy = self.writers[writer]
        proxy.count += 1
        entity = writer[wire.PREFIX_BYTES :]
        part = wire.acknack(self.entity, entity, base, missing, proxy.count, is_final=is_final)
        self.send(writer[: wire.PREFIX_BYTES], [part])
