"""One other robot, as a link sees it: its session, its streams in both directions, and its clock."""

from collections import deque
from collections.abc import Callable
from typing import Protocol

from robbie_mp.link.books import DROPPED, RECEIVED, REFUSED, TAKEN, Books, Key
from robbie_mp.link.clock_offset import ClockOffset, Exchange
from robbie_mp.link.congestion import Window
from robbie_mp.link.header import MAX_COUNTS, Beat, ChannelId, Data, Report
from robbie_mp.link.receiving import Arrived, Fate, ReceiveStream
from robbie_mp.link.sending import Item, Limits, SendChannel, SendStream, start_counting
from robbie_mp.link.traffic import CLASSES, MANNERS, TrafficClass

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
MAX_BURST = 1000
"""Packets sent in one go, before the link looks at what has arrived."""


class Network(Protocol):
    """Sends packets to other robots."""

    def send(self, robot: str, packet: Data | Report | Beat, payload: memoryview | bytes) -> None:
        """Send a packet; it may be lost without a word."""


class Peer:
    """One other robot.

    Args:
        own: the name of this robot.
        name: the name of the other one.
        session: the session of this link.
        books: counts what is exchanged.
        limits: how much may wait.
        max_bytes: size of the largest message.
        network: sends packets.
        handle: publishes a message that has arrived, or refuses it.

    Attributes:
        stale: packets of sessions that are over.
        strange: reports about no session of this link.
    """

    def __init__(
        self,
        own: str,
        name: str,
        session: int,
        books: Books,
        limits: Limits,
        max_bytes: int,
        network: Network,
        handle: Callable[[Arrived], Fate],
    ):
        self.name = name
        self.session = 0
        """Of the other link; 0: nothing has come from it."""
        self.sessions = 0
        """How many sessions of the other link there have been."""
        self.stale = 0
        self.strange = 0
        self.window = Window()
        self.clock = ClockOffset()
        self.newest_state_ns = 0
        """When the newest state was published, by this robot's clock; 0: none has come."""
        self._own = own
        self._own_session = session
        self._books = books
        self._max_bytes = max_bytes
        self._network = network
        self._handle_arrived = handle
        self.streams = {
            traffic: SendStream(traffic, limits, self.window, self._transmit) for traffic in CLASSES
        }
        self._channels: dict[int, SendChannel] = {}
        self._incoming: dict[int, ReceiveStream] = {}
        self._past: deque[int] = deque(maxlen=MAX_PAST_SESSIONS)
        """Sessions of the other link that are over."""
        self._tells_past_until_ns = 0
        self._is_greeted = False
        """Whether a beat of the present session has come."""
        self.last_beat_ns = 0
        """When the last beat arrived; 0: none has."""
        self._last_beat: tuple[int, int] = (0, 0)
        """When it was sent, by the other clock, and when it arrived."""
        self._beat_sent_ns = 0
        self._beat_number = 0
        self._beats_sent: deque[int] = deque(maxlen=64)

    # -- sending ---------------------------------------------------------------------------------------

    def is_up(self, now_ns: int) -> bool:
        """Whether the other link is heard."""
        return self._is_greeted and now_ns - self.last_beat_ns < SILENT_NS

    def channel(self, number: int, name: ChannelId, traffic: TrafficClass, type_hash: int) -> SendChannel:
        """Return a channel as it is sent to this robot."""
        known = self._channels.get(number)
        if known is None:
            key = Key("out", self.name, self._own_session, traffic, number, *name)
            known = self._channels[number] = SendChannel(number, name, type_hash, self._books.row(key))
        return known

    def offer(self, traffic: TrafficClass, item: Item, now_ns: int) -> None:
        """Send a message now or later, or drop and count it."""
        if traffic is TrafficClass.COMMAND and not self.is_up(now_ns):
            item.channel.row.add(TAKEN)
            item.channel.row.add(DROPPED)
            return
        self.streams[traffic].offer(item)

    def holds(self, traffic: TrafficClass, channel: SendChannel) -> bool:
        """Whether a message of a channel waits."""
        return self.streams[traffic].holds(channel)

    def pump(self, now_ns: int) -> None:
        """Send what may be sent now."""
        if not self.is_up(now_ns):
            return
        for _ in range(MAX_BURST):
            if not self._send_one(now_ns):
                return

    def _send_one(self, now_ns: int) -> bool:
        for traffic, stream in self.streams.items():
            if not stream.has_pending:
                continue
            if traffic is TrafficClass.STATE:
                if not self.window.has_room_for_state():
                    continue
            elif MANNERS[traffic].waits_for_room and not self.window.has_room(now_ns):
                return False
            if stream.send_next(now_ns):
                return True
        return False

    def _transmit(self, header: Data, payload: memoryview | bytes) -> None:
        sources = (self._own,) if header.name is not None else ()
        packet = header._replace(robot=self._own, session=self._own_session, to=self.session, sources=sources)
        self._network.send(self.name, packet, payload)

    # -- beats -----------------------------------------------------------------------------------------

    def look_after(self, now_ns: int) -> None:
        """Do what is due: a beat, what has to be sent again."""
        if now_ns - self._beat_sent_ns >= BEAT_NS:
            self._beat(now_ns)
        if self.is_up(now_ns):
            for stream in self.streams.values():
                stream.look_after(now_ns)
        self.pump(now_ns)

    def _beat(self, now_ns: int) -> None:
        self._beat_sent_ns = now_ns
        self._beats_sent.append(now_ns)
        self._beat_number += 1
        sessions = self._books.sessions_of(self.name)
        knows = self.session if self._incoming else next(reversed(sessions), 0)
        self._network.send(
            self.name, Beat(self._own, self._own_session, knows, now_ns, *self._last_beat), b""
        )
        for stream in self._incoming.values():
            stream.is_told = False
        self.tell()
        if now_ns < self._tells_past_until_ns and self._beat_number % PAST_BEATS == 1:
            past = [session for session in sessions if session != self.session]
            for session in past[-PAST_TOLD:]:
                for traffic in self._books.streams_of(self.name, session):
                    self._report(TrafficClass(traffic), session, 0, 0)

    def take_beat(self, beat: Beat, now_ns: int) -> bool:
        """Take note that the other link lives; True if it must first get the latched messages."""
        if not self._is_present(beat.session, now_ns):
            return False
        self.last_beat_ns = now_ns
        self._last_beat = (beat.sent_ns, now_ns)
        if beat.echo_sent_ns in self._beats_sent:
            self.clock.add(Exchange(beat.echo_sent_ns, beat.echo_received_ns, beat.sent_ns, now_ns))
        if self._is_greeted:
            return False
        self._is_greeted = True
        if beat.knows == self._own_session:
            for stream in self.streams.values():
                stream.rewind()
            return False
        self.window.forget_under_way()
        for stream in self.streams.values():
            stream.start_again()
        for channel in self._channels.values():
            start_counting(channel)
        return True

    def _is_present(self, session: int, now_ns: int) -> bool:
        """Whether a session is the present one of the other link; a new one is from now on."""
        if session == self.session:
            return True
        if session in self._past:
            self.stale += 1
            return False
        if self.session:
            self._past.append(self.session)
        self._tells_past_until_ns = now_ns + PAST_NS
        self.session = session
        self.sessions += 1
        self._is_greeted = False
        self.last_beat_ns = 0
        self._last_beat = (0, 0)
        self.clock.forget()
        self._incoming = {
            traffic: self._open(TrafficClass(traffic))
            for traffic in self._books.streams_of(self.name, session)
        }
        return True

    # -- receiving -------------------------------------------------------------------------------------

    def take_data(self, header: Data, payload: bytes, now_ns: int) -> None:
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

    def take_report(self, report: Report, now_ns: int) -> None:
        """Take note of what the other link has received."""
        if report.about == self._own_session:
            if report.session == self.session and self._is_greeted:
                self.streams[report.traffic].take_report(report, self._channels, now_ns)
            return
        counts = {number: (received, refused) for number, received, refused in report.counts}
        self._books.settle_past(self.name, report.about, counts)

    def tell(self) -> None:
        """Tell the other link what has been received."""
        for traffic, stream in self._incoming.items():
            if not stream.is_told:
                stream.is_told = True
                self._report(TrafficClass(traffic), self.session, stream.next, stream.handled)

    def _report(self, traffic: TrafficClass, about: int, following: int, handled: int) -> None:
        counts = tuple(self._books.received_from(self.name, about, traffic)[-MAX_COUNTS:])
        report = Report(
            self._own, traffic, self._own_session, about, max(1, following), max(1, handled), counts
        )
        self._network.send(self.name, report, b"")

    def _open(self, traffic: TrafficClass) -> ReceiveStream:
        row = self._books.row(Key("stream", self.name, self.session, traffic))
        return ReceiveStream(traffic, row, self._handle, self._max_bytes)

    def _handle(self, message: Arrived) -> Fate:
        key = Key("in", self.name, message.session, message.traffic, message.number, *message.name)
        row = self._books.row(key)
        fate = self._handle_arrived(message)
        if fate is Fate.NO_ROOM and not MANNERS[message.traffic].is_resent:
            fate = Fate.REFUSED
        if fate is Fate.PUBLISHED:
            row.add(RECEIVED)
        elif fate is Fate.REFUSED:
            row.add(REFUSED)
        return fate

    @property
    def duplicates(self) -> int:
        """Packets of the present session that had been taken already, or came after newer ones."""
        return sum(stream.duplicates for stream in self._incoming.values())

    @property
    def damaged(self) -> int:
        """Messages of the present session that could not be put together."""
        return sum(stream.damaged for stream in self._incoming.values())

    @property
    def loss(self) -> float:
        """Ratio of packets that were lost on the way, of all packets sent."""
        sent = sum(stream.sequence for stream in self.streams.values())
        return min(1.0, self.resent / sent) if sent else 0.0

    @property
    def resent(self) -> int:
        """Packets sent more than once."""
        return sum(stream.resent for stream in self.streams.values())
