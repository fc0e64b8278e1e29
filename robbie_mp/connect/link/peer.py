"""One other robot, as a link sees it: its session, its streams in both directions, and its clock."""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

from robbie_mp.connect.link.clock_offset import ClockOffset, Exchange
from robbie_mp.connect.link.counts import DROPPED, RECEIVED, REFUSED, TAKEN, CountKey, CountRow, LinkCounts
from robbie_mp.connect.link.header import (
    DATAGRAM_BYTES,
    HEADER_BYTES,
    MAX_COUNTS,
    Beat,
    ChannelId,
    DataHeader,
    ReceiverReport,
)
from robbie_mp.connect.link.receiving import Arrived, Fate, ReceiveStream
from robbie_mp.connect.link.sending import (
    MAX_REPEATED_BYTES,
    Address,
    Item,
    SendChannel,
    SendLimits,
    SendStream,
    start_counting,
)
from robbie_mp.connect.link.traffic import CLASSES, MANNERS, TrafficClass

BEAT_NS = 100_000_000
SILENT_NS = 500_000_000
"""Without a beat for this long, a link is down."""
PAST_NS = 10_000_000_000
"""For this long, a new session of the other robot is told what was received of those before."""
PAST_BEATS = 5
"""It is told with every fifth beat."""
PAST_TOLD = 8
"""Sessions of which it is told."""
MAX_PAST_SESSIONS = 64
MAX_COPIES = 4
COPIED_LOSS = 0.01
"""If a larger share of datagrams is lost, commands and states are sent in several copies."""
APART_NS = 5_000_000
"""Where the network joins datagrams, a copy goes at least this much later than the one before."""
LEAST_COUNTED = 30
"""Datagrams by which the loss is measured."""
MAX_REPORT_COUNTS = 40
"""Channels of a report that fits into a datagram."""
TELL_NS = 2_000_000
"""While packets come, the other link is told that often what has arrived,"""
TELL_BYTES = 128_000
"""and after that many bytes. The module's thread tells the rest with its next tick."""
RATE_NS = 1_000_000_000
"""How often it is measured how much arrives at the other link."""
MAX_BURST = 1000
"""Packets sent in one go, before the link looks at what has arrived."""


class CopiesDue(NamedTuple):
    """A message of one datagram of which copies are still to be sent."""

    header: DataHeader
    payload: memoryview | bytes
    left: int
    """How many."""
    due_ns: int
    """When the next one may go."""


class Network(Protocol):
    """Sends packets to other robots."""

    @property
    def joins_datagrams(self) -> bool:
        """Whether datagrams that are sent at once may go in one packet, and be lost with it."""

    def send(
        self,
        robot: str,
        packet: DataHeader | ReceiverReport | Beat,
        payload: memoryview | bytes,
        *,
        as_datagram: bool = False,
        at_once: bool = False,
    ) -> None:
        """Send a packet; it may be lost without a word.

        Args:
            robot: the receiver.
            packet: its header.
            payload: the rest of it.
            as_datagram: send it alone, so that it never waits for others that the network repeats.
            at_once: do not wait for further packets to send them together.
        """


class Peer:
    """One other robot.

    Args:
        own: the name of this robot.
        name: the name of the other one.
        session: the session of this link.
        counts: counts what is exchanged.
        limits: how much may wait.
        max_bytes: size of the largest message.
        network: sends packets.
        handle: publishes a message that has arrived, or refuses it.

    Attributes:
        stale: packets of sessions that are over, or that have not begun because another is heard.
        uncounted: messages dropped: their session has more channels than a report can tell about.
        strange: reports of what this link has never sent.
    """

    def __init__(
        self,
        own: str,
        name: str,
        session: int,
        counts: LinkCounts,
        limits: SendLimits,
        max_bytes: int,
        network: Network,
        handle: Callable[[Arrived], Fate],
    ):
        self.name = name
        self._address = Address(own, session)
        self.sessions = 0
        """How many sessions of the other link there have been."""
        self.other_version = 0
        """The version of the other link if it is not ours, by its last packet that could not be read."""
        self.stale = 0
        self.strange = 0
        self.uncounted = 0
        self.clock = ClockOffset()
        self.bytes_per_s = 0.0
        """How much has lately arrived at the other link."""
        self._arrived = (0, 0)
        """How much had arrived when that was last measured, and when (ns)."""
        self.newest_state_ns = 0
        """When the newest state was published, by this robot's clock; 0: none has come."""
        self._own = own
        self._own_session = session
        self._counts = counts
        self._max_bytes = max_bytes
        self._network = network
        self._handle_arrived = handle
        self.streams = {
            traffic: SendStream(traffic, limits, self.clock, self._transmit, self._address)
            for traffic in CLASSES
        }
        self._in_turn = tuple(self.streams.values())
        self._channels: dict[int, SendChannel] = {}
        self._incoming: dict[int, ReceiveStream] = {}
        self._past: deque[int] = deque(maxlen=MAX_PAST_SESSIONS)
        """Sessions of the other link that are over."""
        self._tells_past_until_ns = 0
        self._is_greeted = False
        """Whether a beat of the present session has come."""
        self.last_beat_ns = 0
        """When the last beat arrived; 0: none has."""
        self.up_ns = 0
        """When the link last came up."""
        self._last_beat: tuple[int, int] = (0, 0)
        """When it was sent, by the other clock, and when it arrived."""
        self._beat_sent_ns = 0
        self._beat_number = 0
        self._beats_sent: deque[int] = deque(maxlen=64)
        self.lost_there = 0.0
        """Ratio of lost datagrams of those that this link has sent."""
        self._lost_here = 0.0
        self._copies_due: list[CopiesDue] = []
        self._datagrams_sent = 0
        self._datagrams_taken = 0
        self._counted: tuple[int, int] | None = None
        """Datagrams sent by the other link, and taken here, when the loss was last measured."""

    @property
    def session(self) -> int:
        """The session of the other link; 0: nothing has come from it."""
        return self._address.to

    # -- sending ---------------------------------------------------------------------------------------

    def is_up(self, now_ns: int) -> bool:
        """Whether the other link is heard."""
        return self._is_greeted and now_ns - self.last_beat_ns < SILENT_NS

    def channel(self, number: int, name: ChannelId, traffic: TrafficClass, type_hash: int) -> SendChannel:
        """Return a channel as it is sent to this robot."""
        known = self._channels.get(number)
        if known is None:
            key = CountKey("out", self.name, self._own_session, traffic, number, *name)
            known = self._channels[number] = SendChannel(number, name, type_hash, self._counts.row(key))
        return known

    def offer(self, traffic: TrafficClass, item: Item, now_ns: int) -> None:
        """Send a message now or later, or drop and count it."""
        if traffic is TrafficClass.COMMAND and not self.is_up(now_ns):
            item.channel.row.add(TAKEN)
            item.channel.row.add(DROPPED)
            return
        self.streams[traffic].offer(item)

    def pump(self, now_ns: int) -> None:
        """Send what may be sent now."""
        if not self.is_up(now_ns):
            return
        for _ in range(MAX_BURST):
            if not self._send_one(now_ns):
                return

    def _send_one(self, now_ns: int) -> bool:
        for stream in self._in_turn:
            if not (stream.waiting or stream.begun or stream.pending):  # `has_pending`, without a call
                continue
            if stream.has_room(now_ns) and stream.send_next(now_ns):
                return True
        return False

    def _transmit(
        self, header: DataHeader, payload: memoryview | bytes, as_datagram: bool, now_ns: int
    ) -> None:
        if not as_datagram:
            # While others are under way, they go together: only few of Zenoh's batches may wait.
            is_alone = self.streams[header.traffic].under_way.bytes <= HEADER_BYTES + len(payload)
            self._network.send(self.name, header, payload, at_once=is_alone)
            return
        is_urgent = header.traffic is TrafficClass.URGENT
        copies = 1 if is_urgent or header.whole > MAX_REPEATED_BYTES else self._copies
        if header.whole:  # no mark
            self._drop_copies(header.channel, of_commands=is_urgent)
        if copies > 1 and self._network.joins_datagrams and 0 < header.whole <= DATAGRAM_BYTES:
            self._copies_due.append(CopiesDue(header, payload, copies - 1, now_ns + APART_NS))
            copies = 1
        for _ in range(copies):
            self._send_datagram(header, payload)
        if is_urgent:  # on every way there is
            self._network.send(self.name, header, payload)

    def _send_datagram(
        self, packet: DataHeader | ReceiverReport | Beat, payload: memoryview | bytes = b""
    ) -> None:
        self._datagrams_sent += 1
        self._network.send(self.name, packet, payload, as_datagram=True)

    def _drop_copies(self, channel: int, *, of_commands: bool) -> None:
        """Drop copies that would come after a newer message, or commands after something urgent: a stop."""
        self._copies_due = [
            one
            for one in self._copies_due
            if one.header.channel != channel
            and not (of_commands and one.header.traffic is TrafficClass.COMMAND)
        ]

    def _send_copies(self, now_ns: int) -> None:
        waiting, self._copies_due = self._copies_due, []
        for one in waiting:
            if one.due_ns > now_ns:
                self._copies_due.append(one)
                continue
            self._send_datagram(one.header, one.payload)
            if one.left > 1:
                self._copies_due.append(one._replace(left=one.left - 1, due_ns=now_ns + APART_NS))

    @property
    def _copies(self) -> int:
        """How many copies of a datagram are sent, so that one of them probably arrives."""
        copies = 1
        while self.lost_there**copies > COPIED_LOSS and copies < MAX_COPIES:
            copies += 1
        return copies

    # -- beats -----------------------------------------------------------------------------------------

    def look_after(self, now_ns: int) -> None:
        """Do what is due: a beat, what has to be sent again."""
        if now_ns - self._beat_sent_ns >= BEAT_NS:
            self._beat(now_ns)
        if self.is_up(now_ns):
            for stream in self.streams.values():
                stream.look_after(now_ns)
            self.streams[TrafficClass.STATE].repeat_newest(now_ns)
            self._send_copies(now_ns)
        else:
            self._copies_due.clear()
        self._measure_rate(now_ns)
        self.pump(now_ns)

    def _measure_rate(self, now_ns: int) -> None:
        before, since_ns = self._arrived
        if now_ns - since_ns >= RATE_NS:
            arrived = sum(stream.under_way.arrived for stream in self._in_turn)
            self.bytes_per_s = (arrived - before) * 1e9 / (now_ns - since_ns)
            self._arrived = arrived, now_ns

    @property
    def under_way_bytes(self) -> int:
        """How much has been sent, and no report says what has become of it."""
        return sum(stream.under_way.bytes for stream in self._in_turn)

    def _beat(self, now_ns: int) -> None:
        self._beat_sent_ns = now_ns
        self._beats_sent.append(now_ns)
        self._beat_number += 1
        sessions = self._counts.sessions_of(self.name)
        knows = self.session if self._incoming else next(reversed(sessions), 0)
        lost = round(1000 * self._lost_here)
        self._send_datagram(
            Beat(
                self._own, self._own_session, knows, now_ns, *self._last_beat, self._datagrams_sent + 1, lost
            )
        )
        for stream in self._incoming.values():
            stream.is_told = False
        self.tell(now_ns)
        if now_ns < self._tells_past_until_ns and self._beat_number % PAST_BEATS == 1:
            past = [session for session in sessions if session != self.session]
            for session in past[-PAST_TOLD:]:
                for traffic in self._counts.streams_of(self.name, session):
                    self._report(TrafficClass(traffic), session, 0, 0, 0)

    def take_beat(self, beat: Beat, now_ns: int) -> bool:
        """Take note that the other link lives; True if it must first get the latched messages."""
        if not self._is_present(beat.session, now_ns):
            return False
        if not self.is_up(now_ns):
            self.up_ns = now_ns
        self.last_beat_ns = now_ns
        self._last_beat = (beat.sent_ns, now_ns)
        self.lost_there = beat.lost_permille / 1000
        self._measure_loss(beat.datagrams)
        if beat.echo_sent_ns in self._beats_sent:
            self.clock.add(Exchange(beat.echo_sent_ns, beat.echo_received_ns, beat.sent_ns, now_ns))
        if self._is_greeted:
            return False
        self._is_greeted = True
        if beat.knows == self._own_session:
            for stream in self.streams.values():
                stream.continue_with_next()
            return False
        for stream in self.streams.values():
            stream.start_again()
        for channel in self._channels.values():
            start_counting(channel)
        return True

    def took_datagram(self) -> None:
        """Count a datagram that has arrived."""
        self._datagrams_taken += 1

    def _measure_loss(self, sent: int) -> None:
        """Measure by the number of datagrams that the other link has sent."""
        if self._counted is None:
            self._counted = (sent, self._datagrams_taken)
            return
        sent_before, taken_before = self._counted
        if sent - sent_before < LEAST_COUNTED:
            return
        lost = 1.0 - (self._datagrams_taken - taken_before) / (sent - sent_before)
        # As quickly up as it was measured, but slowly down.
        self._lost_here = max(min(1.0, max(0.0, lost)), 0.8 * self._lost_here)
        self._counted = (sent, self._datagrams_taken)

    def _is_present(self, session: int, now_ns: int) -> bool:
        """Whether a session is the present one of the other link; a new one is from now on.

        Not while the present one is heard. The last process of a restarted link is silent, but somebody else
        may send under the robot's name.
        """
        if session == self.session:
            return True
        if session in self._past or self.is_up(now_ns):
            self.stale += 1
            return False
        if self.session:
            self._past.append(self.session)
        self._tells_past_until_ns = now_ns + PAST_NS
        self._address.to = session
        self.sessions += 1
        self._is_greeted = False
        self.last_beat_ns = 0
        self._last_beat = (0, 0)
        self.clock.forget()
        self._counted = None
        self._incoming = {
            traffic: self._open(TrafficClass(traffic))
            for traffic in self._counts.streams_of(self.name, session)
        }
        return True

    # -- receiving -------------------------------------------------------------------------------------

    def take_data(self, header: DataHeader, payload: bytes, now_ns: int) -> None:
        """Take a packet."""
        if not self._is_present(header.session, now_ns):
            return
        if header.to != self._own_session:  # on its way since before this process
            self.stale += 1
            return
        stream = self._incoming.get(header.traffic)
        if stream is None:
            stream = self._incoming[header.traffic] = self._open(header.traffic)
        stream.take(header, payload)

    def take_report(self, report: ReceiverReport, now_ns: int) -> None:
        """Take note of what the other link has received."""
        if report.about == self._own_session:
            if report.session == self.session and self._is_greeted:
                stream = self.streams[report.traffic]
                self.strange += not stream.take_report(report, self._channels, now_ns)
            return
        counts = {number: (received, refused) for number, received, refused in report.counts}
        self._counts.settle_past(self.name, report.about, counts)

    def tell(self, now_ns: int) -> None:
        """Tell the other link what has been received, with what had waited for room here.

        What waits is not published while its sender is silent, except for what is urgent: an operator who is
        gone does not take control.
        """
        for stream in self._incoming.values():
            if stream.traffic is TrafficClass.URGENT or self.is_up(now_ns):
                stream.go_on(now_ns)
            if not stream.is_told:
                self._tell(stream)

    def tell_soon(self, traffic: TrafficClass, now_ns: int) -> None:
        """Tell the other link what has been received of a class, unless it was told just now."""
        stream = self._incoming.get(traffic)
        if (
            stream is not None
            and not stream.is_told
            and (
                now_ns - stream.told_ns >= TELL_NS
                or stream.untold_bytes >= TELL_BYTES
                or stream.misses
                or traffic is TrafficClass.URGENT
            )
        ):
            stream.told_ns = now_ns
            self._tell(stream)

    def _tell(self, stream: ReceiveStream) -> None:
        stream.is_told, stream.untold_bytes = True, 0
        self._report(stream.traffic, self.session, stream.next, stream.handled, stream.newest, stream.misses)

    @property
    def has_more(self) -> bool:
        """Whether there is something to send, now or later."""
        return any(stream.has_pending for stream in self.streams.values())

    def _report(
        self,
        traffic: TrafficClass,
        about: int,
        following: int,
        handled: int,
        newest: int,
        misses: bool = False,
    ) -> None:
        counts = tuple(self._counts.received_from(self.name, about, traffic)[-MAX_COUNTS:])
        following, handled = max(1, following), max(1, handled)
        report = ReceiverReport(
            self._own, traffic, self._own_session, about, following, handled, newest, counts, misses
        )
        if len(counts) <= MAX_REPORT_COUNTS:
            self._send_datagram(report)
        else:
            self._network.send(self.name, report, b"")

    def _open(self, traffic: TrafficClass) -> ReceiveStream:
        row = self._counts.row(CountKey("stream", self.name, self.session, traffic))
        return ReceiveStream(traffic, row, self._handle, self._max_bytes)

    def _handle(self, message: Arrived) -> Fate:
        row = self._row(message)
        if row is None:  # it is in no report, so its sender counts it as lost
            self.uncounted += 1
            return Fate.REFUSED
        fate = self._handle_arrived(message)
        if fate is Fate.NO_ROOM and not MANNERS[message.traffic].is_resent:
            fate = Fate.REFUSED
        if fate is Fate.PUBLISHED:
            row.add(RECEIVED)
        elif fate is Fate.REFUSED:
            row.add(REFUSED)
        return fate

    def _row(self, message: Arrived) -> CountRow | None:
        """Return the row of a message's channel; None if its session has more than can be counted."""
        key = CountKey("in", self.name, message.session, message.traffic, message.number, *message.name)
        return self._counts.row(key) if self._counts.has_room_for(key) else None

    @property
    def duplicates(self) -> int:
        """Packets of the present session that had been taken already, or came after newer ones."""
        return sum(stream.duplicates for stream in self._incoming.values())

    @property
    def loss(self) -> float:
        """Ratio of packets that were lost on the way, of those sent lately."""
        sent = sum(stream.sequence for stream in self.streams.values())
        return max(self.lost_there, min(1.0, self.resent / sent) if sent else 0.0)

    @property
    def resent(self) -> int:
        """Packets sent more than once."""
        return sum(stream.resent for stream in self.streams.values())
