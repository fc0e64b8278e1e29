"""The sending end of a stream: what waits, what is under way, and what must be sent again."""

from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import zstandard

from robbie_mp.link.books import (
    DROPPED,
    LOST,
    RECEIVED,
    RECEIVED_BEFORE,
    REFUSED,
    REFUSED_BEFORE,
    REPLACED,
    TAKEN,
    Row,
)
from robbie_mp.link.congestion import Window
from robbie_mp.link.header import COMPRESSED, DATAGRAM_BYTES, LATCHED, MAX_COUNTS, ChannelId, Data, Report
from robbie_mp.link.traffic import MANNERS, TrafficClass

MIN_COMPRESSED_BYTES = 512
"""Smaller messages are sent as they are."""
COMPRESSION_LEVEL = 1
URGENT_AGAIN_NS = 50_000_000
MIN_AGAIN_NS = 500_000_000
"""Least time after which a packet without an acknowledgement is sent again."""
MAX_AGAIN_NS = 4_000_000_000
MAX_URGENT = 64
"""Urgent messages that may wait."""


@dataclass
class SendChannel:
    """A channel as it is sent to one robot."""

    number: int
    name: ChannelId
    type_hash: int
    row: Row
    settled: int = 0
    """Messages of which the reports so far say what has become of them."""
    lost_before: int = 0
    """Messages lost before the receiver began to count."""
    not_before_ns: int = 0
    """When its next message may be sent."""


@dataclass
class Item:
    """A message that is to be sent."""

    channel: SendChannel
    data: bytes
    stamp_ns: int
    is_latched: bool = False
    convert: Callable[[bytes], bytes] | None = None
    """Makes of `data` what is sent, when its turn has come."""


@dataclass
class Packet:
    """A part of a message that is to be sent, or has been."""

    sequence: int
    item: Item | None
    """None: a mark, of no message."""
    part: int
    parts: int
    payload: memoryview | bytes
    flags: int = 0
    size: int = 0
    """Bytes that it counts in the window."""
    sent_ns: int = 0
    delivered_before: int = 0
    was_full: bool = False
    is_under_way: bool = False
    is_again: bool = False
    """Whether it was sent more than once: then nobody knows which one an acknowledgement is for."""

    @property
    def is_last(self) -> bool:
        """Whether it ends its message."""
        return self.item is not None and self.part == self.parts - 1


class Limits(NamedTuple):
    """How much may wait to be sent."""

    messages: int
    bytes: int
    state_period_ns: int


@dataclass
class Address:
    """Between which links packets go."""

    robot: str
    """The one that sends."""
    session: int
    to: int = 0
    """The session of the other one."""


HEADER_BYTES = 100
"""The size that a header counts in the window."""


@dataclass
class SendStream:
    """Sends the messages of one class to one robot.

    Args:
        traffic: the class.
        limits: how much may wait.
        window: what may be under way, of all classes together.
        transmit: sends a header and a payload.
        address: stands in each header.
    """

    traffic: TrafficClass
    limits: Limits
    window: Window
    transmit: Callable[[Data, memoryview | bytes], None]
    address: Address
    waiting: OrderedDict[int, Item] = field(default_factory=OrderedDict)
    """By number of the channel if only the newest is kept, else by a running number."""
    waiting_bytes: int = 0
    pending: deque[Packet] = field(default_factory=deque)
    """Parts of messages that have been begun, to be sent next."""
    sent: deque[Packet] = field(default_factory=deque)
    """Packets of which no report says that they are settled, oldest first."""
    numbers: set[int] = field(default_factory=set)
    """Of the channels of this class."""
    sequence: int = 0
    """Of the last packet made."""
    resent: int = 0
    """Packets sent more than once."""
    _running: int = 0
    _progress_ns: int = 0
    """When the last packet was sent for the first time, or acknowledged."""
    _again_ns: int = 0
    _rewound_ns: int = 0

    def __post_init__(self) -> None:
        self.manners = MANNERS[self.traffic]
        self._again_ns = self._first_again_ns

    # -- what is to be sent ----------------------------------------------------------------------------

    def offer(self, item: Item) -> None:
        """Take a message; what there is no room for is counted."""
        item.channel.row.add(TAKEN)
        self.numbers.add(item.channel.number)
        self._enter(item)

    def _enter(self, item: Item) -> None:
        if self.manners.keeps_only_newest:
            key = item.channel.number
            replaced = self.waiting.pop(key, None)
            if replaced is not None:
                self.waiting_bytes -= len(replaced.data)
                replaced.channel.row.add(REPLACED)
        else:
            self._running += 1
            key = self._running
        self.waiting[key] = item
        self.waiting_bytes += len(item.data)
        messages = MAX_URGENT if self.traffic is TrafficClass.URGENT else self.limits.messages
        while len(self.waiting) > messages or self._is_too_large:
            self.drop_oldest()

    @property
    def _is_too_large(self) -> bool:
        return self.waiting_bytes > self.limits.bytes and len(self.waiting) > 1

    def drop_oldest(self) -> None:
        """Drop the message that has waited longest, and count it."""
        _, oldest = self.waiting.popitem(last=False)
        self.waiting_bytes -= len(oldest.data)
        oldest.channel.row.add(DROPPED)

    def holds(self, channel: SendChannel) -> bool:
        """Whether a message of a channel waits or is being sent."""
        items = [*self.waiting.values(), *(packet.item for packet in self.pending if packet.item)]
        return any(item.channel is channel for item in items)

    @property
    def has_pending(self) -> bool:
        """Whether there is something to send."""
        return bool(self.pending or self.waiting)

    @property
    def under_way(self) -> int:
        """How many bytes of this class are under way."""
        return sum(packet.size for packet in self.sent if packet.is_under_way)

    def send_next(self, now_ns: int) -> bool:
        """Send one packet; False if there is none that may be sent now."""
        if not self.pending and not self._begin(now_ns):
            return False
        self._send(self.pending.popleft(), now_ns)
        return True

    def _begin(self, now_ns: int) -> bool:
        """Cut the next message into packets; False if there is none that may be sent now."""
        due = (key for key, item in self.waiting.items() if item.channel.not_before_ns <= now_ns)
        key = next(due, None)
        if key is None:
            return False
        item = self.waiting.pop(key)
        self.waiting_bytes -= len(item.data)
        if self.traffic is TrafficClass.STATE:
            item.channel.not_before_ns = now_ns + self.limits.state_period_ns
        if item.convert is not None:
            item.data, item.convert = item.convert(item.data), None
        data, flags = item.data, LATCHED if item.is_latched else 0
        if self.traffic is TrafficClass.BULK and len(data) >= MIN_COMPRESSED_BYTES:
            compressed = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(data)
            if len(compressed) < len(data):
                data, flags = compressed, flags | COMPRESSED
        step = DATAGRAM_BYTES if self.manners.goes_as_datagrams else self.window.part_bytes
        if len(data) <= step:
            self.sequence += 1
            self.pending.append(Packet(self.sequence, item, 0, 1, data, flags))
            return True
        view = memoryview(data)
        parts = -(-len(data) // step)
        for part in range(parts):
            self.sequence += 1
            payload = view[part * step : (part + 1) * step]
            self.pending.append(Packet(self.sequence, item, part, parts, payload, flags))
        return True

    def _send(self, packet: Packet, now_ns: int) -> None:
        if packet.sent_ns:
            self.resent += 1
            packet.is_again = True
        else:
            self._progress_ns = now_ns
        packet.size = HEADER_BYTES + len(packet.payload)
        packet.sent_ns = now_ns
        packet.delivered_before = self.window.sent(packet.size, now_ns)
        packet.is_under_way = True
        self.sent.append(packet)
        packet.was_full = self.window.under_way >= self.window.limit
        oldest = self.sent[0].sequence if self.manners.is_resent else packet.sequence
        header = self._header(packet, oldest)
        self.transmit(header, packet.payload)
        if not self.manners.is_resent:
            packet.payload = b""

    def _header(self, packet: Packet, oldest: int) -> Data:
        item, own = packet.item, self.address
        if item is None:
            return Data(
                own.robot, self.traffic, 0, 0, own.session, own.to, packet.sequence, oldest, 0, 0, 0, 0
            )
        channel = item.channel
        about = () if packet.part else (channel.name, len(item.data), (own.robot,))
        return Data(
            own.robot, self.traffic, packet.flags, channel.number, own.session, own.to, packet.sequence,
            oldest, packet.part, packet.parts, item.stamp_ns, channel.type_hash, *about,
        )  # fmt: skip

    # -- what has become of it -------------------------------------------------------------------------

    def take_report(self, report: Report, channels: dict[int, SendChannel], now_ns: int) -> None:
        """Take note of what the receiver has taken."""
        if report.next > self.sequence + 1:
            return  # about no stream of ours
        settled = report.handled if self.manners.is_resent else report.next
        for packet in self.sent:
            if packet.sequence >= report.next:
                break
            if packet.is_under_way:
                packet.is_under_way = False
                self._progress_ns = now_ns
                self._again_ns = self._first_again_ns
                self.window.acknowledged(packet.size)
                if not packet.is_again:
                    self.window.measure(packet.sent_ns, packet.delivered_before, packet.was_full, now_ns)
        while self.sent and self.sent[0].sequence < settled:
            self._settle(self.sent.popleft())
        while self.pending and self.pending[0].sequence < report.next:  # arrived before it was sent again
            packet = self.pending.popleft()
            if packet.sequence < settled:
                self._settle(packet)
            else:
                self.sent.append(packet)
        self._take_counts(report, channels)
        if report.misses and now_ns - self._rewound_ns > 2 * self.window.round_trip_ns:
            self._rewound_ns = now_ns
            self.rewind()

    def _take_counts(self, report: Report, channels: dict[int, SendChannel]) -> None:
        counts = {number: (received, refused) for number, received, refused in report.counts}
        if len(counts) < MAX_COUNTS:  # of the others, nothing has arrived
            counts = dict.fromkeys(self.numbers, (0, 0)) | counts
        for number, (received, refused) in counts.items():
            channel = channels.get(number)
            if channel is not None and received + refused <= channel.settled:
                row = channel.row
                row[RECEIVED] = row[RECEIVED_BEFORE] + received
                row[REFUSED] = row[REFUSED_BEFORE] + refused
                row[LOST] = channel.lost_before + channel.settled - received - refused

    def _settle(self, packet: Packet) -> None:
        if packet.is_last and packet.item is not None:
            packet.item.channel.settled += 1

    def look_after(self, now_ns: int) -> None:
        """Send again what has no acknowledgement for too long, or ask what has become of it."""
        if not self.sent or now_ns - self._progress_ns < self._wait_ns:
            return
        self._progress_ns = now_ns
        if self.manners.is_resent:
            self._again_ns = min(2 * self._again_ns, MAX_AGAIN_NS)
            self.rewind()
        else:
            self._forget_under_way()
            self.sequence += 1
            self._send(Packet(self.sequence, None, 0, 0, b""), now_ns)

    def rewind(self) -> None:
        """Send everything again that no report says has been handled."""
        self._forget_under_way()
        if self.manners.is_resent:
            self.pending.extendleft(reversed(self.sent))
            self.sent.clear()

    def start_again(self) -> None:
        """Begin with a robot that knows nothing of this stream: what was under way counts as lost."""
        self._forget_under_way()
        begun = [packet for packet in (*self.sent, *self.pending) if packet.is_last]
        self.sent.clear()
        self.pending.clear()
        for packet in begun:
            assert packet.item is not None
            packet.item.channel.row.add(LOST)

    def _forget_under_way(self) -> None:
        for packet in self.sent:
            if packet.is_under_way:
                packet.is_under_way = False
                self.window.given_up(packet.size)

    @property
    def _first_again_ns(self) -> int:
        return URGENT_AGAIN_NS if self.traffic is TrafficClass.URGENT else MIN_AGAIN_NS

    @property
    def _wait_ns(self) -> int:
        if self.traffic is TrafficClass.URGENT:
            return URGENT_AGAIN_NS
        return max(self._again_ns, 3 * self.window.round_trip_ns)

    def next_due_ns(self, now_ns: int) -> Iterator[int]:
        """Yield times at which this stream has something to do, however little arrives."""
        if self.sent:
            yield self._progress_ns + self._wait_ns
        for item in self.waiting.values():
            if item.channel.not_before_ns > now_ns:
                yield item.channel.not_before_ns


def start_counting(channel: SendChannel) -> None:
    """Count from now on what a new receiver reports; what an earlier one has reported stays."""
    row = channel.row
    row[RECEIVED_BEFORE], row[REFUSED_BEFORE] = row[RECEIVED], row[REFUSED]
    channel.lost_before, channel.settled = row[LOST], 0
