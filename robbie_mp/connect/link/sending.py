"""The sending end of a stream: what waits, what is under way, and what must be sent again."""

from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import zstandard

from robbie_mp.connect.link.clock_offset import ClockOffset
from robbie_mp.connect.link.counts import (
    DROPPED,
    LOST,
    RECEIVED,
    RECEIVED_BEFORE,
    REFUSED,
    REFUSED_BEFORE,
    REPLACED,
    TAKEN,
    CountRow,
)
from robbie_mp.connect.link.header import (
    COMPRESSED,
    DATAGRAM_BYTES,
    HEADER_BYTES,
    LATCHED,
    ChannelId,
    DataHeader,
    ReceiverReport,
)
from robbie_mp.connect.link.safety import stops
from robbie_mp.connect.link.send_window import SendWindow
from robbie_mp.connect.link.traffic import MANNERS, TrafficClass
from robbie_mp.connect.link.under_way import UnderWay

MIN_COMPRESSED_BYTES = 512
"""Smaller messages are sent as they are."""
COMPRESSION_LEVEL = 1
SAMPLES = 8
SAMPLE_BYTES = 2048
"""The samples of a message more than four times as large tell whether it is worth compressing,"""
LEAST_SHRUNK = 0.97
"""which is so if they become at least this much shorter."""
URGENT_AGAIN_NS = 50_000_000
MIN_AGAIN_NS = 500_000_000
"""Least time after which a packet without an acknowledgement is sent again."""
MAX_AGAIN_NS = 4_000_000_000
MAX_URGENT_AGAIN_NS = 200_000_000
"""Most time between two repetitions of what is urgent: they must not fill a network that is slow."""
MAX_URGENT = 64
"""Urgent messages that may wait, and packets with others that may be without an acknowledgement."""
MAX_UNREPORTED = 1024
"""Packets that are not sent again of which the link waits for a report."""
MISSED_BYTES_PER_S = 1_000_000
"""What the other link misses is sent again at this rate at most: one that misses something in each report
must not make this one fill the network."""
MISSED_PER_SETTLED = 8
"""Each byte that is settled allows for this many more: all that follows a lost packet is sent again, too."""
MAX_SAVED_NS = 250_000_000
"""What was not used of that is saved, up to what this time allows for."""
STATE_AGAIN_NS = 20_000_000
"""A state is sent again if its report takes this much longer than a round trip,"""
MAX_REPEATS = 3
"""at most this many times."""
MAX_REPEATED_BYTES = 8 * DATAGRAM_BYTES
"""Longer messages are neither sent in copies nor, as states, again: they would fill a slow network."""
MAX_UNSETTLED_BYTES = 1 << 25
"""What may be unsettled at most, or as much as may wait."""


@dataclass(slots=True)
class SendChannel:
    """A channel as it is sent to one robot."""

    number: int
    name: ChannelId
    type_hash: int
    row: CountRow
    settled: int = 0
    """Messages of which the reports so far say what has become of them."""
    lost_before: int = 0
    """Messages lost before the receiver began to count."""
    not_before_ns: int = 0
    """When its next message may be sent."""


@dataclass(slots=True)
class Item:
    """A message that is to be sent."""

    channel: SendChannel
    data: bytes
    stamp_ns: int
    is_latched: bool = False
    convert: Callable[[bytes], bytes] | None = None
    """Makes of `data` what is sent, when its turn has come."""
    size: int = 0
    """Bytes of the message, once its turn has come."""


@dataclass(slots=True)
class Packet:
    """A part of a message that is to be sent, or has been."""

    sequence: int
    item: Item | None
    """None: a mark, of no message."""
    start: int
    """Where it begins in the message."""
    whole: int
    """Bytes of the message."""
    payload: memoryview | bytes
    flags: int = 0
    is_again: bool = False
    """Whether it has been sent before."""
    is_last: bool = field(init=False)
    """Whether it ends its message."""
    size: int = field(init=False)
    """Bytes that it counts in what is under way."""

    def __post_init__(self) -> None:
        size = len(self.payload)
        self.is_last = self.item is not None and self.start + size == self.whole
        self.size = HEADER_BYTES + size


@dataclass(slots=True)
class Newest:
    """The newest state of a channel, until it is known to have arrived."""

    parts: list[tuple[Packet, memoryview | bytes]]
    """Its packets so far, with what they carry."""
    sent_ns: int
    """When it was last sent; 0: send it again at once."""
    repeats: int = 0
    is_lost: bool = False
    """Whether a report has said that it, or one before it, has not arrived."""

    @property
    def last(self) -> Packet:
        """Its last packet so far."""
        return self.parts[-1][0]


@dataclass(slots=True)
class Begun:
    """A message that is being cut into packets."""

    item: Item
    data: bytes
    flags: int
    start: int = 0
    """How much of it has been cut off."""


class SendLimits(NamedTuple):
    """How much may wait to be sent."""

    messages: int
    bytes: int
    state_period_ns: int


@dataclass(slots=True)
class Address:
    """Between which links packets go."""

    robot: str
    """The one that sends."""
    session: int
    to: int = 0
    """The session of the other one."""


@dataclass
class SendStream:
    """Sends the messages of one class to one robot.

    Args:
        traffic: the class.
        limits: how much may wait.
        clock: knows the round trip.
        transmit: sends a header and a payload, as a datagram or in the stream; it is told the present time.
        address: stands in each header.
    """

    traffic: TrafficClass
    limits: SendLimits
    clock: ClockOffset
    transmit: Callable[[DataHeader, memoryview | bytes, bool, int], None]
    address: Address
    waiting: OrderedDict[int, Item] = field(default_factory=OrderedDict)
    """By number of the channel if only the newest is kept, else by a running number."""
    waiting_bytes: int = 0
    pending: deque[Packet] = field(default_factory=deque)
    """Packets to be sent next, before those of `begun`."""
    begun: Begun | None = None
    """The message of which some parts are not yet packets."""
    sent: deque[Packet] = field(default_factory=deque)
    """Packets of which no report says that they are settled, oldest first."""
    numbers: set[int] = field(default_factory=set)
    """Numbers of the channels of this class."""
    sequence: int = 0
    """Number of the last packet made."""
    resent: int = 0
    """Packets sent more than once."""
    unheeded: int = 0
    """Reports that miss something so soon after the last ones that nothing was sent again for them."""
    unsettled_bytes: int = 0
    """Of packets that have been cut and are not settled."""
    _running: int = 0
    _progress_ns: int = 0
    """When the last packet was sent for the first time, or acknowledged."""
    _again_ns: int = 0
    _rewound_at: int = 0
    """The number of the last sending when everything was last to be sent again."""
    _heeds_misses_ns: int = 0
    """When what is missed may next be sent again."""
    _told: tuple[int, int, int] = (0, 0, 0)
    """What the newest report says: the newest sending, the next packet, and the next to be handled."""
    _newest: dict[int, Newest] = field(default_factory=dict)
    """States by number of their channel."""

    def __post_init__(self) -> None:
        self.manners = MANNERS[self.traffic]
        self.under_way = UnderWay()
        may_pause = self.traffic is TrafficClass.BULK
        self.window = SendWindow(pauses=may_pause) if self.manners.waits_for_room else None
        self._most_waiting = MAX_URGENT if self.traffic is TrafficClass.URGENT else self.limits.messages
        self._again_ns = self._first_again_ns

    # -- what is to be sent ----------------------------------------------------------------------------

    def offer(self, item: Item) -> None:
        """Take a message; what there is no room for is counted."""
        item.channel.row.add(TAKEN)
        self.numbers.add(item.channel.number)
        if self.manners.keeps_only_newest:
            key = item.channel.number
            replaced = self.waiting.get(key)  # the new one takes its place, or it might never be its turn
            if replaced is not None:
                self.waiting_bytes -= len(replaced.data)
                replaced.channel.row.add(REPLACED)
        else:
            self._running += 1
            key = self._running
        self.waiting[key] = item
        self.waiting_bytes += len(item.data)
        while len(self.waiting) > self._most_waiting or (
            self.waiting_bytes > self.limits.bytes and len(self.waiting) > 1
        ):
            self._drop_oldest()

    def _drop_oldest(self) -> None:
        """Drop the message of the channel that has waited longest, and count it."""
        _, oldest = self.waiting.popitem(last=False)
        self.waiting_bytes -= len(oldest.data)
        oldest.channel.row.add(DROPPED)

    def holds(self, channel: int) -> bool:
        """Whether a message of the channel with this number waits or is being sent."""
        items = [*self.waiting.values(), *(packet.item for packet in self.pending if packet.item)]
        items += [self.begun.item] if self.begun else []
        return any(item.channel.number == channel for item in items)

    @property
    def has_pending(self) -> bool:
        """Whether there is something to send."""
        return bool(self.pending or self.begun or self.waiting)

    def has_room(self, now_ns: int) -> bool:
        """Whether one more packet may be under way."""
        return self.window is None or self.window.has_room(self.under_way.bytes, now_ns)

    def send_next(self, now_ns: int) -> bool:
        """Send one packet; False if there is none that may be sent now."""
        if self.pending:
            self._send(self.pending.popleft(), now_ns)
            return True
        if self.begun is None and (self._is_full or not self._begin(now_ns)):
            return False
        self._send(self._cut(), now_ns)
        return True

    @property
    def _is_full(self) -> bool:
        """Whether too much is unsettled to send more: the other link handles nothing that it takes."""
        if self.traffic is TrafficClass.URGENT:
            return len(self.sent) + len(self.pending) >= MAX_URGENT
        return self.manners.is_resent and self.unsettled_bytes > max(self.limits.bytes, MAX_UNSETTLED_BYTES)

    def _begin(self, now_ns: int) -> bool:
        """Begin with the next message; False if there is none that may be sent now."""
        if self.traffic is TrafficClass.STATE:
            due = (key for key, item in self.waiting.items() if item.channel.not_before_ns <= now_ns)
            key = next(due, None)
            if key is None:
                return False
            item = self.waiting.pop(key)
        elif self.waiting:
            _, item = self.waiting.popitem(last=False)
        else:
            return False
        self.waiting_bytes -= len(item.data)
        if self.traffic is TrafficClass.STATE:
            item.channel.not_before_ns = now_ns + self.limits.state_period_ns
        if item.convert is not None:
            item.data, item.convert = item.convert(item.data), None
        data, flags = item.data, LATCHED if item.is_latched else 0
        item.size = len(data)
        if self.traffic is TrafficClass.BULK and len(data) >= MIN_COMPRESSED_BYTES and seems_to_shrink(data):
            compressed = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(data)
            if len(compressed) < len(data):
                data, flags = compressed, flags | COMPRESSED
        self.begun = Begun(item, data, flags)
        return True

    def _cut(self) -> Packet:
        """Return the next part of the message that has been begun, as large as it may be now."""
        begun = self.begun
        assert begun is not None
        data, start = begun.data, begun.start
        step = DATAGRAM_BYTES
        if self.window is not None and not self.manners.goes_as_datagrams:
            step = max(step, self.window.part_bytes(self.under_way.bytes))
        payload = memoryview(data)[start : start + step]
        begun.start += len(payload)
        if begun.start >= len(data):
            self.begun = None
        self.sequence += 1
        packet = Packet(self.sequence, begun.item, start, len(data), payload, begun.flags)
        self.unsettled_bytes += packet.size
        return packet

    def _send(self, packet: Packet, now_ns: int) -> None:
        if packet.is_again:
            self.resent += 1
        else:
            packet.is_again = True
            self._progress_ns = now_ns
        number = self.under_way.add(packet.sequence, packet.size, now_ns)
        if self.window is not None:
            self.window.sent(packet.size, now_ns)
        self.sent.append(packet)
        oldest = self.sent[0].sequence if self.manners.is_resent else packet.sequence
        header = self._header(packet, oldest, number)
        self.transmit(header, packet.payload, self.manners.goes_as_datagrams, now_ns)
        if self.manners.is_resent:
            return
        if self.traffic is TrafficClass.STATE and packet.item is not None:
            self._note_newest(packet.item.channel, packet, now_ns)
        packet.payload = b""
        if len(self.sent) > MAX_UNREPORTED:
            self._settle(self.sent.popleft())

    def _note_newest(self, channel: SendChannel, packet: Packet, now_ns: int) -> None:
        """Remember a state until it has arrived, unless it is too long to be sent again."""
        known = self._newest.get(channel.number)
        if packet.whole > MAX_REPEATED_BYTES:
            self._newest.pop(channel.number, None)
        elif packet.start == 0:
            self._newest[channel.number] = Newest([(packet, packet.payload)], now_ns)
        elif known is not None and known.last.item is packet.item:
            known.parts.append((packet, packet.payload))
            known.sent_ns = now_ns

    def repeat_newest(self, now_ns: int) -> None:
        """Send the newest state of each channel again if it has probably been lost."""
        wait_ns = self._round_trip_ns * 5 // 4 + STATE_AGAIN_NS
        for number, newest in list(self._newest.items()):
            if now_ns - newest.sent_ns < wait_ns or not newest.last.is_last:
                continue
            if newest.repeats >= MAX_REPEATS:
                del self._newest[number]
            elif self.has_room(now_ns):
                newest.repeats += 1
                newest.sent_ns = now_ns
                for packet, payload in newest.parts:
                    self.resent += 1
                    sending = self.under_way.add(packet.sequence, packet.size, now_ns)
                    self.transmit(self._header(packet, packet.sequence, sending), payload, True, now_ns)

    def _header(self, packet: Packet, oldest: int, number: int) -> DataHeader:
        item, own = packet.item, self.address
        channel, stamp_ns, type_hash = 0, 0, 0
        about: tuple[()] | tuple[ChannelId, int] = ()
        if item is not None:
            channel, stamp_ns, type_hash = item.channel.number, item.stamp_ns, item.channel.type_hash
            about = () if packet.start else (item.channel.name, item.size)
        return DataHeader(
            own.robot, self.traffic, packet.flags, channel, own.session, own.to, packet.sequence,
            oldest, number, packet.start, packet.whole, stamp_ns, type_hash, *about,
        )  # fmt: skip

    # -- what has become of it -------------------------------------------------------------------------

    def take_report(self, report: ReceiverReport, channels: dict[int, SendChannel], now_ns: int) -> bool:
        """Take note of what the receiver has taken; False if the report tells of what was never sent."""
        told = (report.newest, report.next, report.handled)
        if told < self._told:
            return True  # a newer one has overtaken it
        if report.next > self.sequence + 1 or report.newest > self.under_way.number:
            return False  # about no stream of ours
        self._told = told
        settled = report.handled if self.manners.is_resent else report.next
        arrival = self.under_way.report(report.newest, report.next, now_ns)
        if arrival.bytes:
            self._progress_ns = now_ns
            self._again_ns = self._first_again_ns
            if self.window is not None:
                self.window.take(arrival, now_ns)
        while self.sent and self.sent[0].sequence < settled:
            self._settle(self.sent.popleft())
        while self.pending and self.pending[0].sequence < report.next:  # arrived before it was sent again
            packet = self.pending.popleft()
            if packet.sequence < settled:
                self._settle(packet)
            else:
                self.sent.append(packet)
        is_possible = self._take_counts(report, channels)
        self._forget_arrived(report.next)
        # What was already under way when everything was to be sent again is missed once more.
        if report.misses and report.newest > self._rewound_at:
            self._send_missed(now_ns)
        return is_possible

    def _send_missed(self, now_ns: int) -> None:
        """Send everything again, unless so much was sent again lately that it is too soon."""
        if now_ns < self._heeds_misses_ns:
            self.unheeded += 1
            return
        size = sum(packet.size for packet in self.sent)
        self._heeds_misses_ns = max(self._heeds_misses_ns, now_ns - MAX_SAVED_NS) + _missed_ns(size)
        self.rewind()

    def _forget_arrived(self, following: int) -> None:
        """Forget the states that have arrived; `following` is `ReceiverReport.next`."""
        for number, newest in list(self._newest.items()):
            if newest.last.is_last and newest.last.sequence < following and not newest.is_lost:
                del self._newest[number]

    def _take_counts(self, report: ReceiverReport, channels: dict[int, SendChannel]) -> bool:
        """Take over counts, but for those of more messages than are settled; False if there are such."""
        is_possible = True
        counts = dict.fromkeys(self.numbers, (0, 0))  # of those that it does not name, nothing has arrived
        counts |= {number: (received, refused) for number, received, refused in report.counts}
        for number, (received, refused) in counts.items():
            channel = channels.get(number)
            if channel is None or received + refused > channel.settled:
                is_possible = False
            else:
                row = channel.row
                row[RECEIVED] = row[RECEIVED_BEFORE] + received
                row[REFUSED] = row[REFUSED_BEFORE] + refused
                lost = channel.lost_before + channel.settled - received - refused
                newest = self._newest.get(number)
                if newest is not None and lost != row[LOST]:
                    newest.is_lost = lost > row[LOST]
                    newest.sent_ns = 0 if newest.is_lost else newest.sent_ns
                row[LOST] = lost
        return is_possible

    def _settle(self, packet: Packet) -> None:
        self.unsettled_bytes -= packet.size
        self._heeds_misses_ns -= _missed_ns(MISSED_PER_SETTLED * packet.size)
        if packet.is_last and packet.item is not None:
            packet.item.channel.settled += 1

    def look_after(self, now_ns: int) -> None:
        """Send again what has no acknowledgement for too long, or ask what has become of it."""
        if not (self.sent or self.under_way.bytes) or now_ns - self._progress_ns < self._wait_ns:
            return
        self._progress_ns = now_ns
        if not (self.sent or self.pending):  # all has arrived; what was sent twice may be lost
            self.under_way.forget()
        elif self.manners.is_resent:
            is_urgent = self.traffic is TrafficClass.URGENT
            self._again_ns = min(2 * self._again_ns, MAX_URGENT_AGAIN_NS if is_urgent else MAX_AGAIN_NS)
            if is_urgent and not self._is_blocked:
                self.rewind()
            # One at once, although all room is taken: its report says what else has not arrived. A stream
            # repeats by itself what the network loses, so all of it would come twice.
            self._send(self.pending.popleft() if self.pending else self.sent.pop(), now_ns)
        else:
            self.sequence += 1
            mark = Packet(self.sequence, None, 0, 0, b"")
            self.unsettled_bytes += mark.size
            self._send(mark, now_ns)

    @property
    def _is_blocked(self) -> bool:
        """Whether the other link has taken a whole message and has no room for it."""
        taken = self._told[1] - 1
        return any(packet.sequence == taken and packet.is_last for packet in self.sent)

    def rewind(self) -> None:
        """Send everything again that no report says has been handled."""
        self._rewound_at = self.under_way.number
        if self.manners.is_resent:
            self.pending.extendleft(reversed(self.sent))
            self.sent.clear()

    def continue_with_next(self) -> None:
        """Go on with a new process of the other link, which has the last one's counts."""
        self.under_way.forget()  # what was for the last one is dropped
        self._told = (0, 0, 0)
        self.rewind()

    def start_again(self) -> None:
        """Begin with a link that knows nothing of this stream: what was under way counts as lost.

        That it may have arrived is no harm if it lets the robot stand: rather a stop twice than none.
        `start_counting` counts it.
        """
        self.continue_with_next()
        begun = [packet.item for packet in (*self.sent, *self.pending) if packet.is_last]
        for item in reversed(begun + ([self.begun.item] if self.begun else [])):
            if item is not None and self.manners.is_resent and stops(item.channel.name.type_name, item.data):
                self._running += 1
                self.waiting[self._running] = item
                self.waiting.move_to_end(self._running, last=False)
                self.waiting_bytes += len(item.data)
            elif item is not None:
                item.channel.settled += 1
        self._newest.clear()
        self.sent.clear()
        self.pending.clear()
        self.begun, self.unsettled_bytes = None, 0

    @property
    def _first_again_ns(self) -> int:
        return URGENT_AGAIN_NS if self.traffic is TrafficClass.URGENT else MIN_AGAIN_NS

    @property
    def _wait_ns(self) -> int:
        if self.traffic is TrafficClass.URGENT:
            return self._again_ns
        return max(self._again_ns, 3 * self._round_trip_ns)

    @property
    def _round_trip_ns(self) -> int:
        return self.clock.round_trip_ns or 0


def _missed_ns(size: int) -> int:
    """Return how long it takes to send so many bytes again that are missed."""
    return size * 1_000_000_000 // MISSED_BYTES_PER_S


def seems_to_shrink(data: bytes) -> bool:
    """Whether a message probably becomes shorter when it is compressed; samples of a large one tell.

    Args:
        data: the message.
    """
    if len(data) < SAMPLES * SAMPLE_BYTES * 4:
        return True
    step = len(data) // SAMPLES
    sample = b"".join([data[start : start + SAMPLE_BYTES] for start in range(0, step * SAMPLES, step)])
    shrunk = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(sample)
    return len(shrunk) < LEAST_SHRUNK * len(sample)


def start_counting(channel: SendChannel) -> None:
    """Count from now on what a new receiver reports; what an earlier one has not reported is lost."""
    row = channel.row
    told = row[RECEIVED] - row[RECEIVED_BEFORE] + row[REFUSED] - row[REFUSED_BEFORE]
    row[LOST] = channel.lost_before + channel.settled - told
    row[RECEIVED_BEFORE], row[REFUSED_BEFORE] = row[RECEIVED], row[REFUSED]
    channel.lost_before, channel.settled = row[LOST], 0
